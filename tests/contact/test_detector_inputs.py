"""Inputs that the detector accepts and refuses, with its errors; and its results are not changed by later queries."""

from __future__ import annotations

import numpy as np
import pytest

from spatula_env.contact import Contacts, FlaggedDetector
from spatula_env.geometry import Tool, box_surface

PLATE = Tool.box((1.0, 1.0, 0.125), 3)
CUBE = box_surface((4.0, 4.0, 4.0), 0.7)
GOOD = {
    "position": (0.0137, 0.0271, 0.3),
    "orientation": (0.0, 0.0, 0.0, 1.0),
    "vertices": CUBE.vertices,
    "triangles": CUBE.triangles,
    "linear_velocity": (0.0, 0.0, 1.0),
    "angular_velocity": (0.0, 0.0, 0.0),
}
FLAGS = np.arange(18) % 3 == 0


def with_entry(array, index, value):
    changed = np.array(array, dtype=np.asarray(array).dtype)
    changed[index] = value
    return changed


BAD = [
    ("position", (0.0, 0.0)),
    ("position", 1.0),
    ("position", (0.0, 0.0, np.nan)),
    ("position", (0.0, 0.0, -np.inf)),
    ("position", ((0.0, 0.0, 0.0),)),
    ("position", None),
    ("position", ("a", "b", "c")),
    ("orientation", (0.0, 0.0, 0.0)),
    ("orientation", (0.0, 0.0, 0.0, 0.0)),
    ("orientation", (0.0, 0.0, 0.0, 1.1)),
    ("orientation", (0.0, 0.0, 0.0, 1.0 + 2e-6)),
    ("orientation", (1.0, 1.0, 1.0, 1.0)),
    ("orientation", (0.0, 0.0, 0.0, np.nan)),
    ("orientation", (0.0, np.inf, 0.0, 1.0)),
    ("orientation", np.eye(3)),
    ("linear_velocity", (0.0, 0.0)),
    ("linear_velocity", (0.0, np.nan, 0.0)),
    ("linear_velocity", (np.inf, 0.0, 0.0)),
    ("angular_velocity", (0.0,)),
    ("angular_velocity", (0.0, np.nan, 0.0)),
    ("angular_velocity", (np.inf, 0.0, 0.0)),
    ("vertices", CUBE.vertices[:, :2]),
    ("vertices", CUBE.vertices.ravel()),
    ("vertices", CUBE.vertices[None]),
    ("vertices", None),
    ("vertices", [["a", "b", "c"]]),
    ("vertices", [[0.0, 1.0], [0.0, 1.0, 2.0]]),
    ("vertices", with_entry(CUBE.vertices, (0, 0), np.nan)),
    ("vertices", with_entry(CUBE.vertices, (-1, 2), np.inf)),
    ("vertices", with_entry(CUBE.vertices, (7, 1), -np.inf)),
    ("triangles", CUBE.triangles[:, :2]),
    ("triangles", CUBE.triangles.ravel()),
    ("triangles", CUBE.triangles.astype(np.float64)),
    ("triangles", CUBE.triangles > 3),
    ("triangles", [[0, 1, 2.5]]),
    ("triangles", [[0, 1], [0, 1, 2]]),
    ("triangles", None),
    ("triangles", with_entry(CUBE.triangles, (0, 0), -1)),
    ("triangles", with_entry(CUBE.triangles, (-1, 2), len(CUBE.vertices))),
    ("triangles", with_entry(CUBE.triangles.astype(np.int64), (5, 1), 2**40)),
    ("triangles", with_entry(CUBE.triangles.astype(np.int64), (5, 1), 2**32)),
]


@pytest.mark.parametrize(("name", "value"), BAD)
def test_a_bad_argument_is_named_and_changes_nothing(name, value):
    detector = FlaggedDetector(PLATE)
    detector.flags = FLAGS
    with pytest.raises(ValueError, match=name):
        detector.detect(**(GOOD | {name: value}))
    np.testing.assert_array_equal(detector.flags, FLAGS)
    # And it still works.
    contacts = detector.detect(**GOOD)
    expected = FlaggedDetector(PLATE)
    expected.flags = FLAGS
    np.testing.assert_array_equal(contacts.flags, expected.detect(**GOOD).flags)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("position", (1e308, 1e308, 0.0)),
        ("orientation", (0.0, 0.0, 0.0, 1.0 + 1e-6)),
        ("linear_velocity", (1e308, 1e308, 1e308)),
    ],
)
def test_at_the_limits_the_right_argument_is_named(name, value):
    # Finite and huge, or of unit length to the last digit allowed: it may be refused, but not for the mesh's fault.
    detector = FlaggedDetector(PLATE)
    try:
        detector.detect(**(GOOD | {name: value}))
    except ValueError as error:
        assert name in str(error)


def test_errors_tell_what_came_and_what_is_allowed():
    detector = FlaggedDetector(PLATE)
    with pytest.raises(ValueError, match=r"\(3,\).*\(2,\)"):
        detector.detect(**(GOOD | {"position": (0.0, 0.0)}))
    with pytest.raises(ValueError, match=r"from 0 to 217.*1 of 432"):
        detector.detect(**(GOOD | {"triangles": with_entry(CUBE.triangles, (0, 0), 218)}))
    with pytest.raises(ValueError, match=r"2 of 218"):
        detector.detect(**(GOOD | {"vertices": with_entry(CUBE.vertices, ([3, 9], 1), np.nan)}))
    with pytest.raises(ValueError, match=r"1\.1"):
        detector.detect(**(GOOD | {"orientation": (0.0, 0.0, 0.0, 1.1)}))


def read_only(array):
    array = np.array(array)
    array.setflags(write=False)
    return array


@pytest.mark.parametrize(
    "convert",
    [
        np.ndarray.tolist,
        read_only,
        np.asfortranarray,
        lambda array: np.repeat(array, 2, axis=0)[::2],
        lambda array: array.astype(array.dtype.newbyteorder()),
        lambda array: array[::-1].copy()[::-1],
        lambda array: array.astype(np.float32 if array.dtype.kind == "f" else np.int64),
        lambda array: array.astype(np.longdouble if array.dtype.kind == "f" else np.uint16),
    ],
    ids=["list", "read-only", "Fortran", "strided", "big-endian", "reversed", "narrow", "wide"],
)
def test_arrays_of_all_kinds_are_taken_and_left_alone(convert):
    # Multiples of 1/8 have no rounding error in single precision.
    vertices = np.round(8.0 * CUBE.vertices) / 8.0
    plain = GOOD | {"position": (0.015625, 0.03125, 0.25), "vertices": vertices}
    expected = FlaggedDetector(PLATE).detect(**plain)
    given = {name: convert(np.array(value)) for name, value in plain.items()}
    copies = {name: np.array(value) for name, value in given.items()}
    contacts = FlaggedDetector(PLATE).detect(**given)
    assert contacts.flags.any()
    for name in ("flags", "unfeasible", "triangle", "barycentric", "depth", "normal", "points"):
        np.testing.assert_array_equal(getattr(contacts, name), getattr(expected, name))
    for name, value in given.items():
        np.testing.assert_array_equal(value, copies[name])


def test_integers_are_numbers():
    given = {"position": [0, 0, 0], "orientation": [0, 0, 0, 1], "linear_velocity": np.array([0, 0, 3])}
    contacts = FlaggedDetector(PLATE).detect(**(GOOD | given))
    assert contacts.flags[PLATE.face == 1].all()


def test_an_orientation_of_nearly_unit_length_counts_as_of_unit_length():
    expected = FlaggedDetector(PLATE).detect(**GOOD)
    for factor in (1.0 - 9e-7, 1.0 + 9e-7):
        contacts = FlaggedDetector(PLATE).detect(**(GOOD | {"orientation": (0.0, 0.0, 0.0, factor)}))
        np.testing.assert_array_equal(contacts.flags, expected.flags)
        np.testing.assert_allclose(contacts.depth, expected.depth, rtol=0.0, atol=1e-12)
    negative = FlaggedDetector(PLATE).detect(**(GOOD | {"orientation": (0.0, 0.0, 0.0, -1.0)}))
    np.testing.assert_array_equal(negative.depth, expected.depth)


def test_without_triangles_there_is_no_contact():
    detector = FlaggedDetector(PLATE)
    detector.flags = FLAGS
    contacts = detector.detect(**(GOOD | {"triangles": np.zeros((0, 3), dtype=np.int32)}))
    assert not contacts.flags.any()
    assert (contacts.triangle == -1).all()
    nothing = {"vertices": np.zeros((0, 3)), "triangles": np.zeros((0, 3), dtype=np.int32)}
    assert not detector.detect(**(GOOD | nothing)).flags.any()


def test_triangles_without_area_are_not_seen():
    # Two needles and a point, on the rays' way.
    extra = np.array([[0.0137, 0.0271, 0.0], [0.0137, 0.0271, -1.0], [0.0137, 0.0271, -1.5]])
    vertices = np.concatenate([CUBE.vertices, extra])
    n = len(CUBE.vertices)
    needles = np.array([[n, n + 1, n + 2], [n, n, n + 1], [n, n, n], [0, 1, 1]], dtype=np.int32)
    contacts = FlaggedDetector(PLATE).detect(
        **(GOOD | {"vertices": vertices, "triangles": np.concatenate([needles, CUBE.triangles])})
    )
    expected = FlaggedDetector(PLATE).detect(**GOOD)
    np.testing.assert_array_equal(contacts.flags, expected.flags)
    np.testing.assert_array_equal(contacts.depth, expected.depth)
    np.testing.assert_array_equal(contacts.triangle[contacts.flags], expected.triangle[contacts.flags] + len(needles))


def test_organs_of_different_sizes_one_after_the_other():
    # Whatever the detector keeps from one query to the next must not depend on how many vertices there were.
    small, large = box_surface((4.0, 4.0, 4.0), 4.0), box_surface((4.0, 4.0, 4.0), 0.2)
    detector = FlaggedDetector(PLATE)
    for organ in (small, large, small):
        contacts = detector.detect(**(GOOD | {"vertices": organ.vertices, "triangles": organ.triangles}))
        np.testing.assert_array_equal(contacts.flags, PLATE.face == 1)
        np.testing.assert_allclose(contacts.depth[PLATE.face == 1], 2.3 + 0.0625, atol=1e-12)


# Results belong to the caller --------------------------------------------------------------------------------------


def test_results_are_of_the_promised_types_and_shapes():
    contacts = FlaggedDetector(PLATE).detect(**GOOD)
    assert isinstance(contacts, Contacts)
    shapes = {
        "flags": ((18,), np.bool_),
        "unfeasible": ((18,), np.bool_),
        "triangle": ((18,), np.int32),
        "barycentric": ((18, 3), np.float64),
        "depth": ((18,), np.float64),
        "normal": ((18, 3), np.float64),
        "points": ((18, 3), np.float64),
    }
    for name, (shape, dtype) in shapes.items():
        array = getattr(contacts, name)
        assert array.shape == shape
        assert array.dtype == dtype


NAMES = ("flags", "unfeasible", "triangle", "barycentric", "depth", "normal", "points")


def test_later_queries_do_not_change_earlier_results():
    detector = FlaggedDetector(PLATE)
    first = detector.detect(**GOOD)
    kept = {name: np.array(getattr(first, name)) for name in NAMES}
    detector.detect(**(GOOD | {"position": (0.0137, 0.0271, -1.98)}))
    detector.detect(**(GOOD | {"position": (0.0, 0.0, 9.0)}))
    detector.reset()
    for name in NAMES:
        np.testing.assert_array_equal(getattr(first, name), kept[name])


def test_writing_to_results_does_not_change_the_memory():
    detector = FlaggedDetector(PLATE)
    contacts = detector.detect(**GOOD)
    expected = np.array(detector.flags)
    contacts.flags[:] = ~contacts.flags
    contacts.triangle[:] = 7
    flags = detector.flags
    flags[:] = ~flags
    np.testing.assert_array_equal(detector.flags, expected)
    given = np.array(FLAGS)
    detector.flags = given
    given[:] = False
    np.testing.assert_array_equal(detector.flags, FLAGS)


def test_detectors_do_not_share_memory():
    one, other = FlaggedDetector(PLATE), FlaggedDetector(PLATE)
    one.detect(**GOOD)
    assert one.flags.any()
    assert not other.flags.any()


@pytest.mark.parametrize("value", [np.zeros(17, dtype=bool), np.zeros(18), np.zeros((18, 1), dtype=bool), True, None])
def test_flags_must_be_one_bool_a_node(value):
    detector = FlaggedDetector(PLATE)
    detector.flags = FLAGS
    with pytest.raises(ValueError, match=r"flags must be a bool array of shape \(18,\)"):
        detector.flags = value
    np.testing.assert_array_equal(detector.flags, FLAGS)


@pytest.mark.parametrize("value", ["outside", "Inside", "", None, True, 2])
def test_first_step_must_be_known(value):
    with pytest.raises(ValueError, match=r"first_step.*inside.*any_hit.*off"):
        FlaggedDetector(PLATE, value)
