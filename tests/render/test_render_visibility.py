from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from render_helpers import BLUE, GREY, RED, ahead, is_color, mix, quad, wall

from spatula_env.render import UNLIT, Camera, GroundPlane, Mesh, Renderer, box_mesh, sphere_mesh

BLACK = (0.0, 0.0, 0.0)
WHITE = (1.0, 1.0, 1.0)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(16, 12)


def draw(renderer, meshes, camera=None, background=BLACK, **options):
    return renderer.render(camera or ahead(), meshes, background=background, **options)


def test_every_byte_comes_back_as_itself(renderer):
    for value in range(256):
        grey = (value / 255,) * 3
        assert (draw(renderer, [wall(2.0, color=grey)]) == value).all()
        assert (draw(renderer, [], background=grey) == value).all()


def test_a_triangle_over_the_left_half(renderer):
    vertices = np.array([(0.0, 1, -1e3), (0, 1, 1e3), (-1e6, 1, 0)])
    mesh = Mesh(vertices, np.array([[0, 1, 2]]), color=RED, material=UNLIT)
    picture = draw(renderer, [mesh])
    assert is_color(picture[:, :8], RED).all()
    assert is_color(picture[:, 8:], BLACK).all()


def test_a_border_in_the_middle_of_a_pixel_mixes_light():
    picture = draw(Renderer(5, 4), [wall(1.0, right=0.0, color=RED)], background=BLUE)
    assert is_color(picture[:, :2], RED).all()
    assert is_color(picture[:, 3:], BLUE).all()
    np.testing.assert_allclose(picture[:, 2], np.tile(mix((0.5, RED), (0.5, BLUE)), (4, 1)), atol=0.51)


@pytest.mark.parametrize("supersample", [1, 2, 3, 4])
def test_coverage_of_a_slanted_border_is_its_area(supersample):
    # Left of the line x = z / 3, which passes through the middle of the picture.
    mesh = quad([(-9, 1, -3), (-1, 1, -3), (1, 1, 3), (-9, 1, 3)], color=WHITE)
    picture = draw(Renderer(60, 40, supersample), [mesh])
    light = ((picture / 255.0 + 0.055) / 1.055) ** 2.4 * (picture > 10)
    assert light[..., 0].mean() == pytest.approx(0.5, abs=0.004 / supersample)
    if supersample > 1:
        assert len(np.unique(picture)) > 2


@given(
    st.tuples(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9)),
    st.lists(st.floats(0.0, 2 * np.pi), min_size=3, max_size=9, unique=True),
    st.floats(-1.0, 1.0),
    st.floats(-1.0, 1.0),
)
@settings(max_examples=60, deadline=None)
# Where the middle is right on a sample, five edges end in it.
@example((-0.25, 0.25), [0.0, 1.0, 2.0], 0.0, 1.0)
def test_no_gap_and_no_overlap_between_neighbours(middle, angles, slope_x, slope_z):
    # A fan of half transparent triangles around a point: a gap would show the background, an overlap would be
    # darker. The plane leans, so that depth differs from place to place.
    angles = np.sort(np.concatenate([np.array(angles), np.linspace(0, 2 * np.pi, 5)[:-1]]))
    rim = np.stack([40 * np.cos(angles), 40 * np.sin(angles)], axis=1)
    flat = np.concatenate([[middle], rim])
    depth = 60.0 + 0.5 * (slope_x * flat[:, 0] + slope_z * flat[:, 1])
    # On the ray through (x, z) of the plane at depth 1, so that the fan covers the picture from every angle.
    vertices = np.stack([flat[:, 0] * depth / 9, depth, flat[:, 1] * depth / 9], axis=1)
    count = len(angles)
    triangles = np.array([(0, 1 + i, 1 + (i + 1) % count) for i in range(count)])
    mesh = Mesh(vertices, triangles, color=WHITE, opacity=0.5, material=UNLIT, two_sided=True)
    picture = draw(Renderer(24, 18), [mesh])
    np.testing.assert_allclose(picture, mix((0.5, WHITE), (0.5, BLACK))[0], atol=0.51)


@pytest.mark.parametrize(("size", "sides"), [((7, 1), ("low", "high")), ((1, 7), ("left", "right"))])
def test_a_sample_right_on_a_common_border_belongs_to_one_side(size, sides):
    # In a picture one sample high or wide, all samples lie on z = 0 or x = 0, and nothing is rounded.
    meshes = [wall(1.0, color=WHITE, opacity=0.5, **{side: 0.0}) for side in sides]
    picture = draw(Renderer(*size, supersample=1), meshes)
    np.testing.assert_allclose(picture, mix((0.5, WHITE), (0.5, BLACK))[0], atol=0.51)


@pytest.mark.parametrize("nearest_first", [True, False])
def test_the_nearest_wins_in_any_order(renderer, nearest_first):
    meshes = [wall(2.0, color=RED, right=0.0), wall(3.0, color=BLUE)]
    picture = draw(renderer, meshes if nearest_first else meshes[::-1])
    assert is_color(picture[:, :8], RED).all()
    assert is_color(picture[:, 8:], BLUE).all()


def test_two_planes_that_cross():
    # They meet where x = 0: there the one gets behind the other.
    first = quad([(-40, -20, -90), (40, 60, -90), (40, 60, 90), (-40, -20, 90)], color=RED)
    second = quad([(-40, 60, -90), (40, -20, -90), (40, -20, 90), (-40, 60, 90)], color=BLUE)
    picture = draw(Renderer(16, 12), [first, second])
    assert is_color(picture[:, :8], RED).all()
    assert is_color(picture[:, 8:], BLUE).all()


def test_winding(renderer):
    back = [(2, 2, -9), (-9, 2, -9), (-9, 2, 9), (2, 2, 9)]
    assert is_color(draw(renderer, [quad(back, color=RED)]), BLACK).all()
    seen = slice(0, 12)
    assert is_color(draw(renderer, [quad(back, color=RED, two_sided=True)])[:, seen], RED).all()
    both = draw(renderer, [quad(back, color=RED, back_color=BLUE)])
    assert is_color(both[:, seen], BLUE).all()
    assert is_color(draw(renderer, [wall(2.0, color=RED, back_color=BLUE)]), RED).all()


def test_clip_plane_removes_the_side_of_its_normal(renderer):
    for normal, kept in (((0, 0, 3), slice(6, 12)), ((0, 0, -1), slice(0, 6))):
        mesh = wall(2.0, color=RED, clip_plane=((5.0, 5.0, 0.0), normal))
        picture = draw(renderer, [mesh])
        assert is_color(picture[kept], RED).all()
        assert is_color(picture, RED).sum() == picture[kept].shape[0] * 16


def test_a_clipped_sphere_shows_its_inside():
    sphere = sphere_mesh((0, 4, 0), 2.0, color=RED, material=UNLIT, subdivisions=3)
    cut = replace(sphere, back_color=BLUE, clip_plane=((0, 4, 0), (0, -1, 0)))
    y, x = np.mgrid[:32, :32] + 0.5 - 16
    for mesh, color, radius in ((sphere, RED, 16 * 2 / np.sqrt(12)), (cut, BLUE, 16 * 2 / 4)):
        # Whole, its outline is where rays touch it; cut in half, its equator.
        picture = draw(Renderer(32, 32), [mesh])
        assert is_color(picture[np.hypot(x, y) < radius - 1], color).all()
        assert is_color(picture[np.hypot(x, y) > radius + 1], BLACK).all()


def box_with_cut(**options) -> Mesh:
    box = box_mesh((2, 2, 2), (0, 4, 0), material=UNLIT)
    return Mesh(box.vertices, box.triangles, color=RED, back_color=BLUE, smooth=False, material=UNLIT, **options)


def test_cap_closes_the_cut_at_its_plane():
    renderer = Renderer(32, 32)
    mesh = box_with_cut(clip_plane=((0, 4, 0), (0, -1, 0)), capped=True)
    picture, depth = renderer.render_rgbd(ahead(), [mesh], background=BLACK)
    # A square of one unit to each side at depth 4.
    square = np.zeros((32, 32), dtype=bool)
    square[12:20, 12:20] = True
    np.testing.assert_array_equal(is_color(picture, BLUE), square)
    assert is_color(picture[~square], BLACK).all()
    np.testing.assert_allclose(depth[square], 4.0, rtol=1e-6)


@pytest.mark.parametrize("rind", [0.0, 0.05])
def test_what_stands_before_the_cut_hides_it_and_what_is_inside_is_hidden(rind):
    renderer = Renderer(32, 32)
    mesh = box_with_cut(clip_plane=((0, 4, 0), (0, -1, 0)), capped=True, rind=rind)
    before = draw(renderer, [mesh, wall(3.0, left=0.0, color=GREY)])
    assert is_color(before[13:19, 13:16], BLUE).all()
    assert is_color(before[:, 16:], GREY).all()
    behind = draw(renderer, [mesh, wall(4.5, left=0.0, color=GREY)])
    assert is_color(behind[13:19, 13:19], BLUE).all()


def test_no_cap_seen_from_the_kept_side_or_through_a_shape_behind_the_plane():
    renderer = Renderer(32, 32)
    from_behind = box_with_cut(clip_plane=((0, 4, 0), (0, 1, 0)), capped=True)
    assert not is_color(draw(renderer, [from_behind]), BLUE).any()
    # The plane lies before the whole box: nothing is cut, and the front is seen.
    uncut = box_with_cut(clip_plane=((0, 2, 0), (0, -1, 0)), capped=True)
    picture = draw(renderer, [uncut])
    assert not is_color(picture, BLUE).any()
    assert is_color(picture, RED).any()


def test_rind_is_a_band_along_the_border_of_the_section():
    renderer = Renderer(64, 64)
    sphere = sphere_mesh((0, 4, 0), 2.0, color=RED, material=UNLIT, subdivisions=4)
    mesh = replace(sphere, back_color=BLUE, clip_plane=((0, 4, 0), (0, -1, 0)), capped=True, rind=0.5)
    picture = draw(renderer, [mesh])
    # The scale is 8 pixels per unit at depth 4: radius 16, without the rind 12.
    y, x = np.mgrid[:64, :64] + 0.5 - 32
    distance = np.hypot(x, y)
    assert is_color(picture[distance < 11], BLUE).all()
    band = picture[(distance > 13) & (distance < 15)]
    assert (band == band[0]).all()
    assert not is_color(band[:1], BLUE).any()
    assert is_color(picture[distance > 17], BLACK).all()


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_translucent_layers_blend_in_order_of_depth(renderer, order):
    meshes = [
        wall(2.0, color=RED, opacity=0.3),
        wall(3.0, color=BLUE, opacity=0.6),
        wall(4.0, color=GREY),
    ]
    picture = draw(renderer, [meshes[i] for i in order], background=WHITE)
    expected = mix((0.3, RED), (0.7 * 0.6, BLUE), (0.7 * 0.4, GREY))
    np.testing.assert_allclose(picture, np.broadcast_to(expected, picture.shape), atol=0.51)


def test_translucent_behind_opaque_is_not_seen_and_before_background_is(renderer):
    picture = draw(renderer, [wall(2.0, right=0.0, color=RED), wall(3.0, color=BLUE, opacity=0.5)], background=GREY)
    assert is_color(picture[:, :8], RED).all()
    expected = mix((0.5, BLUE), (0.5, GREY))
    np.testing.assert_allclose(picture[:, 8:], np.broadcast_to(expected, (12, 8, 3)), atol=0.51)


def test_many_translucent_triangles_in_one_row():
    # More pieces of work in a row than the renderer keeps at once.
    layers = [wall(2.0 + 0.01 * i, color=RED, opacity=0.02) for i in range(50)]
    picture = draw(Renderer(8, 6), layers)
    expected = mix((1 - 0.98**50, RED), (0.98**50, BLACK))
    np.testing.assert_allclose(picture, np.broadcast_to(expected, picture.shape), atol=0.6)


def test_opacity_zero_is_invisible(renderer):
    assert is_color(draw(renderer, [wall(2.0, opacity=0.0)], background=RED), RED).all()


slopes = st.floats(-0.6, 0.6)


@given(slopes, slopes, st.floats(1.0, 20.0))
@settings(deadline=None)
def test_depth_is_that_of_the_plane(slope_x, slope_z, offset):
    # y = offset + slope_x x + slope_z z, hit by the ray (x, 1, z) t at t = offset / (1 - slope_x x - slope_z z).
    renderer = Renderer(16, 12)
    corners = [
        (x * 30.0, offset + slope_x * x * 30.0 + slope_z * z * 30.0, z * 30.0)
        for x, z in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    camera = ahead(near=0.01, far=1000.0)
    _, depth = renderer.render_rgbd(camera, [quad(corners, two_sided=True)])
    focal = 6.0
    x = (np.arange(16) + 0.5 - 8) / focal
    z = -(np.arange(12) + 0.5 - 6) / focal
    meets = 1 - slope_x * x[None, :] - slope_z * z[:, None]
    # What the corner of a pixel sees that looks furthest along the plane: it must still lie on it.
    corner = meets - (abs(slope_x) + abs(slope_z)) * 0.5 / focal
    reach = np.maximum(np.abs(x)[None, :], np.abs(z)[:, None]) + 0.5 / focal
    inside = corner > np.maximum(offset * reach / 28.0, 0.02)
    expected = offset / np.where(inside, meets, 1.0)
    assert inside.any()
    np.testing.assert_allclose(depth[inside], expected[inside], rtol=1e-5)


def test_depth_of_ground_and_of_nothing():
    camera = Camera((0, 0, 3), (0, 1, 3), vertical_field_of_view=90.0, far=50.0)
    _, depth = Renderer(16, 12).render_rgbd(camera, [], ground=GroundPlane(height=1.0))
    down = (np.arange(12) + 0.5 - 6) / 6.0
    expected = np.where(down > 0, np.minimum(2.0 / np.where(down > 0, down, 1), 50.0), 50.0)
    np.testing.assert_allclose(depth, np.tile(expected[:, None], (1, 16)), rtol=1e-5)


def test_depth_does_not_mix_objects(renderer):
    _, depth = Renderer(15, 12).render_rgbd(ahead(), [wall(2.0, right=0.0), wall(8.0)])
    assert set(np.round(np.unique(depth), 4)) == {2.0, 8.0}


def test_translucent_surfaces_have_no_depth(renderer):
    _, depth = renderer.render_rgbd(ahead(), [wall(2.0, opacity=0.9), wall(8.0)])
    np.testing.assert_allclose(depth, 8.0, rtol=1e-6)


def test_a_floor_that_reaches_behind_the_eye_is_cut_at_the_near_plane():
    # The floor z = -1 from far behind to far ahead: visible where its depth 1 / down is beyond the near plane.
    floor = quad([(-500, -300, -1), (500, -300, -1), (500, 900, -1), (-500, 900, -1)], color=RED)
    camera = ahead(near=1.5, far=1000.0)
    picture, depth = Renderer(16, 12).render_rgbd(camera, [floor], background=BLACK)
    down = (np.arange(12) + 0.5 - 6) / 6.0
    expected = np.where(down > 0, 1.0 / np.where(down > 0, down, 1), np.inf)
    # In the row of depth 1.5 the plane passes through the pixels.
    seen = (expected > 1.55) & (expected < 900)
    clear = (expected < 1.45) | (down < 0)
    assert seen.sum() >= 3
    assert clear.sum() >= 8
    assert is_color(picture[seen], RED).all()
    assert is_color(picture[clear], BLACK).all()
    np.testing.assert_allclose(depth[seen], np.tile(expected[seen][:, None], (1, 16)), rtol=1e-5)


def test_a_section_counts_what_lies_beyond_the_far_plane():
    # The box ends behind the far plane; its section does not.
    camera = ahead(near=1.0, far=4.5)
    mesh = box_with_cut(clip_plane=((0, 4, 0), (0, -1, 0)), capped=True)
    assert is_color(draw(Renderer(32, 32), [mesh], camera=camera)[12:20, 12:20], BLUE).all()


def test_nothing_behind_the_eye_or_beyond_the_far_plane(renderer):
    camera = ahead(near=1.0, far=10.0)
    for depth in (-3.0, 0.5, 11.0):
        assert is_color(draw(renderer, [wall(depth, two_sided=True, color=RED)], camera=camera), BLACK).all()
    assert is_color(draw(renderer, [wall(9.9, color=RED)], camera=camera), RED).all()


def test_colors_are_interpolated_in_perspective():
    # A wall that leans away: its colour goes with the place on it, not with the place in the picture.
    corners = [(-4, 1, -40), (4, 9, -40), (4, 9, 40), (-4, 1, 40)]
    share = (np.array(corners)[:, 0] + 4) / 8
    colors = share[:, None] * np.ones(3)
    picture, depth = Renderer(16, 12).render_rgbd(ahead(), [quad(corners, vertex_colors=colors)])
    points = ahead().unproject(depth)
    # Interpolated in linear light, between black and white.
    expected = mix((1.0, BLACK))[0] + 255 * np.array(
        [[np.interp(x, (-4, 4), (0, 1)) for x in row] for row in points[..., 0]]
    )
    linear = ((picture[..., 0] / 255 + 0.055) / 1.055) ** 2.4
    solid = (expected > 20) & (expected < 200)
    assert solid.sum() > 50
    np.testing.assert_allclose(linear[solid] * 255, expected[solid], atol=1.5)


def test_equal_input_gives_equal_bytes_whatever_was_drawn_before():
    camera = Camera.orbit((0, 0, 1), 6.0, 30, 20)
    ball = sphere_mesh((0, 0, 1), 1.0)
    scene = [ball, sphere_mesh((1, 0, 1), 0.7, opacity=0.4), box_mesh((1, 1, 1), (-1, 1, 0.5), bevel=0.1)]
    fresh = Renderer(40, 30).render_rgbd(camera, scene, ground=GroundPlane())
    used = Renderer(40, 30)
    others = [sphere_mesh(np.random.default_rng(0).normal(size=(60, 3)), 0.3, opacity=0.5)]
    used.render(Camera.orbit((0, 0, 1), 3.0, 80, 40), others, ground=GroundPlane(style="checker"), background=RED)
    used.render(camera, others, ground=GroundPlane())
    again = used.render_rgbd(camera, scene, ground=GroundPlane())
    np.testing.assert_array_equal(fresh[0], again[0])
    np.testing.assert_array_equal(fresh[1], again[1])
    np.testing.assert_array_equal(fresh[0], used.render(camera, scene, ground=GroundPlane()))


def test_a_picture_is_the_same_in_one_band_and_in_many():
    # A tall picture is drawn in many bands; its upper part is that of a short one with the same rays.
    camera = Camera((0, 0, 0), (0, 1, 0), vertical_field_of_view=90.0)
    mesh = sphere_mesh((0.3, 4, 0.2), 2.0, subdivisions=1)
    tall = Renderer(1024, 64).render(camera, [mesh], background=GREY)
    wide = Renderer(64, 64).render(camera, [mesh], background=GREY)
    np.testing.assert_array_equal(tall[:, 480:544], wide)


def test_out_is_drawn_into(renderer):
    out = np.zeros((12, 16, 3), dtype=np.uint8)
    assert draw(renderer, [wall(2.0, color=RED)], out=out) is out
    assert is_color(out, RED).all()


def test_pictures_do_not_share_memory(renderer):
    first = draw(renderer, [wall(2.0, color=RED)])
    draw(renderer, [wall(2.0, color=BLUE)])
    assert is_color(first, RED).all()


@pytest.mark.parametrize(
    "out",
    [
        np.zeros((12, 16, 4), dtype=np.uint8),
        np.zeros((12, 16, 3), dtype=np.float32),
        np.zeros((12, 32, 3), dtype=np.uint8)[:, ::2],
    ],
)
def test_bad_out(renderer, out):
    with pytest.raises(ValueError, match="out"):
        draw(renderer, [], out=out)


@pytest.mark.parametrize("arguments", [(0, 8), (8, 0), (8, 8, 5), (8, 8.5), (9000, 8)])
def test_bad_sizes(arguments):
    with pytest.raises(ValueError, match=r"width|height|supersample"):
        Renderer(*arguments)


def test_bad_background(renderer):
    with pytest.raises(ValueError, match="background"):
        draw(renderer, [], background=(0.0, 0.0))


def test_triangles_without_area_are_not_drawn(renderer):
    flat = Mesh(np.array([(0.0, 2, 0), (1, 2, 0), (2, 2, 0)]), np.array([[0, 1, 2]]), color=RED, two_sided=True)
    assert is_color(draw(renderer, [flat]), BLACK).all()
