from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from render_helpers import BLUE, GREY, RED, decode, is_color, quad

from spatula_env.render import (
    BRUSHED_STEEL,
    MATTE,
    UNLIT,
    WET_TISSUE,
    Background,
    Camera,
    GroundPlane,
    Lighting,
    Material,
    Mesh,
    Renderer,
    arrow_mesh,
    box_mesh,
    sphere_mesh,
)

DULL = Material(specular=0.0, rim=0.0)
WHITE = (1.0, 1.0, 1.0)


def from_above(height=10.0, angle=60.0) -> Camera:
    return Camera((0, 0, height), (0, 0, 0), up=(0, 1, 0), vertical_field_of_view=angle)


def plate(height, half=1.0, middle=(0.0, 0.0), **options) -> Mesh:
    x, y = middle
    corners = [(x + a * half, y + b * half, height) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return quad(corners, **options)


def brightness(picture) -> np.ndarray:
    return decode(picture / 255.0).mean(axis=-1)


def test_diffuse_light_goes_with_the_cosine():
    # Only the key light: a plate turned by some angle against it gives the cosine of that angle.
    lighting = Lighting(key_direction=(0, 0, 1), key=0.5, fill=0.0, ambient=0.0)
    renderer = Renderer(8, 8, lighting=lighting)
    for angle in (0.0, 0.5, 1.0):
        c, s = np.cos(angle), np.sin(angle)
        corners = [(a * c, b, a * s) for a, b in ((-3, -3), (3, -3), (3, 3), (-3, 3))]
        picture = renderer.render(from_above(angle=5.0), [quad(corners, color=WHITE, material=DULL)])
        assert brightness(picture).mean() == pytest.approx(0.5 * c * (1.0 + 0.975 + 0.94) / 3, rel=0.02)


def test_shaded_side_is_darker_and_flesh_is_softer():
    lighting = Lighting(key_direction=(1, 0, 0.2), ambient=0.0, fill=0.0)
    renderer = Renderer(33, 33, lighting=lighting)
    camera = Camera((0, -10, 0), (0, 0, 0), vertical_field_of_view=14.0)
    dull = brightness(renderer.render(camera, [sphere_mesh((0, 0, 0), 1.0, material=DULL)], background=(0, 0, 0)))
    flesh = Material(specular=0.0, rim=0.0, subsurface=1.0)
    soft = brightness(renderer.render(camera, [sphere_mesh((0, 0, 0), 1.0, material=flesh)], background=(0, 0, 0)))
    assert dull[16, 26] > 5 * dull[16, 12] + 0.05
    assert dull[16, 14] == 0.0
    assert soft[16, 14] > 0.005


def test_smooth_shading_hides_the_facets_and_flat_shows_them():
    ball = sphere_mesh((0, 0, 0), 1.0, subdivisions=2, material=DULL)
    flat = Mesh(ball.vertices, ball.triangles, color=ball.color, smooth=False, material=DULL)
    renderer = Renderer(96, 96)
    camera = Camera.orbit((0, 0, 0), 4.0, 10, 80, vertical_field_of_view=20.0)
    center = np.s_[8:88, 8:88]
    step = {
        mesh.smooth: np.abs(np.diff(renderer.render(camera, [mesh]).astype(int)[center], axis=1)).max()
        for mesh in (ball, flat)
    }
    assert step[True] <= 3
    assert step[False] > 3 * step[True]


def test_highlight_is_where_the_half_vector_is_the_normal():
    lighting = Lighting(key_direction=(0.3, 0.2, 1.0), ambient=0.0, fill=0.0)
    renderer = Renderer(121, 121, lighting=lighting)
    camera = Camera((0, 0, 100), (0, 0, 0), up=(0, 1, 0), vertical_field_of_view=1.3)
    shiny = Material(specular=1.0, shininess=1024.0, rim=0.0)
    ball = sphere_mesh((0, 0, 0), 1.0, color=(0, 0, 0), material=shiny, subdivisions=4)
    picture = renderer.render(camera, [ball], background=(0, 0, 0))
    row, column = np.unravel_index(np.argmax(picture.sum(axis=-1)), picture.shape[:2])
    half = np.add(lighting.key_direction, (0, 0, 1))
    expected, _ = camera.project(half / np.linalg.norm(half), 121, 121)
    assert np.hypot(column + 0.5 - expected[0], row + 0.5 - expected[1]) < 3.0


def test_a_mesh_shadows_another():
    lighting = Lighting(key_direction=(0, 0, 1), ambient=0.3, fill=0.0, shadow=1.0)
    renderer = Renderer(64, 64, lighting=lighting)
    floor = plate(0.0, 4.0, color=WHITE, material=DULL)
    # Seen from below, so that the roof does not hide its shadow: look at the floor at an angle.
    camera = Camera((0, -10, 1.5), (0, 0, 0), vertical_field_of_view=30.0)
    roof = plate(3.0, 1.0, material=DULL, two_sided=True)
    lit = brightness(renderer.render(camera, [floor]))
    dark = brightness(renderer.render(camera, [floor, roof]))
    inside, outside = (camera.project(point, 64, 64)[0].astype(int) for point in ((0.3, 0, 0), (2.5, 0, 0)))
    assert dark[inside[1], inside[0]] < 0.6 * lit[inside[1], inside[0]]
    assert dark[outside[1], outside[0]] == lit[outside[1], outside[0]]
    for keep in ({"casts_shadow": False}, {"opacity": 0.0}):
        roof = plate(3.0, 1.0, material=DULL, two_sided=True, **keep)
        ignored = brightness(renderer.render(camera, [floor, roof]))
        assert ignored[inside[1], inside[0]] == lit[inside[1], inside[0]]
    deaf = plate(0.0, 4.0, color=WHITE, material=DULL, receives_shadow=False)
    ignored = brightness(renderer.render(camera, [deaf, plate(3.0, 1.0, material=DULL)]))
    assert ignored[inside[1], inside[0]] == lit[inside[1], inside[0]]


def test_a_mesh_does_not_shadow_what_is_above_it():
    renderer = Renderer(64, 64, lighting=Lighting(key_direction=(0, 0, 1)))
    roof = plate(2.0, 1.0, material=DULL)
    alone = renderer.render(from_above(), [roof], background=RED)
    both = renderer.render(from_above(), [roof, plate(0.0, 9.0, color=RED, material=UNLIT)])
    seen = ~is_color(alone, RED)
    assert seen.sum() > 100
    # Up to the border, beyond which the shadow map shows what is below.
    np.testing.assert_array_equal(alone[seen], both[seen])


def test_a_mesh_does_not_shadow_itself():
    renderer = Renderer(64, 64, lighting=Lighting(key_direction=(1, 0, 0.3)))
    ball = sphere_mesh((0, 0, 1), 1.0, subdivisions=1)
    deaf = Mesh(ball.vertices, ball.triangles, color=ball.color, receives_shadow=False)
    camera = Camera.orbit((0, 0, 1), 4, 30, 20)
    # Another mesh, so that shadows are looked up at all; it is below the ball and shadows nothing.
    floor = plate(-6.0, 9.0, material=UNLIT)
    np.testing.assert_array_equal(renderer.render(camera, [ball, floor]), renderer.render(camera, [deaf, floor]))


def test_shadow_on_the_ground_lies_away_from_the_light():
    ground = GroundPlane(style="plain", fade_start=50.0, fade_end=60.0)
    renderer = Renderer(64, 64, lighting=Lighting(key_direction=(-1, 0, 1), shadow_softness=0.1))
    bare = brightness(renderer.render(from_above(), [], ground=ground))
    # At 45 degrees, the shadow of a plate 2 u above the ground falls 2 u to the right.
    picture = brightness(renderer.render(from_above(), [plate(2.0, 0.5, material=DULL)], ground=ground))
    ratio = {}
    for x in (-2.0, 2.0):
        column, row = from_above().project((x, 0.0, 0.0), 64, 64)[0].astype(int)
        ratio[x] = picture[row, column] / bare[row, column]
    assert ratio[2.0] < 0.75
    assert ratio[-2.0] > 0.97
    none = renderer.render(
        from_above(),
        [plate(2.0, 0.5, material=DULL)],
        ground=GroundPlane(style="plain", shadow=0.0, fade_start=50, fade_end=60),
    )
    column, row = from_above().project((2.0, 0.0, 0.0), 64, 64)[0].astype(int)
    assert brightness(none)[row, column] == bare[row, column]


def test_things_close_to_the_ground_darken_it_below():
    ground = GroundPlane(style="plain", fade_start=50.0, fade_end=60.0)
    # The light is so low that the key light's shadow falls beside the plate, not under it.
    renderer = Renderer(64, 64, lighting=Lighting(key_direction=(-1, 0, 0.3), shadow_softness=0.1))
    camera = Camera((0, -8, 3), (0, 0, 0), vertical_field_of_view=20.0)
    column, row = camera.project((-0.5, -0.5, 0.0), 64, 64)[0].astype(int)
    bare = brightness(renderer.render(camera, [], ground=ground))[row, column]
    low, high = (
        brightness(renderer.render(camera, [plate(height, 0.7, material=DULL)], ground=ground))[row, column]
        for height in (0.25, 3.0)
    )
    assert low < 0.85 * bare
    assert high > 0.95 * bare


def test_shadow_with_the_light_map_partly_behind_the_eye():
    # The ground in shadow reaches behind the camera: it is darkened all the same.
    ground = GroundPlane(style="plain", fade_start=50.0, fade_end=60.0)
    renderer = Renderer(32, 32, lighting=Lighting(key_direction=(0, 0, 1)))
    camera = Camera((0, 0, 1), (0, 3, 0))
    bare = brightness(renderer.render(camera, [], ground=ground))
    roofed = brightness(renderer.render(camera, [plate(5.0, 8.0, material=DULL)], ground=ground))
    column, row = camera.project((0.0, 3.0, 0.0), 32, 32)[0].astype(int)
    assert roofed[row, column] < 0.75 * bare[row, column]


def test_checker_tiles_are_where_they_should_be():
    ground = GroundPlane(style="checker", color=RED, second_color=BLUE, tile=1.0, fade_start=50.0, fade_end=60.0)
    renderer = Renderer(80, 80)
    camera = from_above()
    picture = renderer.render(camera, [], ground=ground)
    x, y = np.meshgrid(np.arange(-3.5, 4.0), np.arange(-3.5, 4.0))
    pixels, _ = camera.project(np.stack([x, y, 0 * x], axis=-1), 80, 80)
    colors = picture[pixels[..., 1].astype(int), pixels[..., 0].astype(int)]
    even = (np.floor(x) + np.floor(y)) % 2 == 0
    assert (is_color(colors, RED) == even).all() or (is_color(colors, BLUE) == even).all()
    assert (is_color(colors, RED) | is_color(colors, BLUE)).all()


def test_far_tiles_and_lines_average_out():
    # Tiles much smaller than a pixel show their mean, without a pattern.
    for style, share in (("checker", 0.5), ("grid", 1 - 0.9**2)):
        ground = GroundPlane(
            style=style,
            color=(0, 0, 0),
            second_color=WHITE,
            tile=0.01,
            line_width=0.001,
            fade_start=500.0,
            fade_end=600.0,
        )
        light = brightness(Renderer(40, 40).render(from_above(), [], ground=ground))
        np.testing.assert_allclose(light, share, atol=0.02)


def test_grid_lines_lie_at_multiples_of_the_tile():
    ground = GroundPlane(color=(0, 0, 0), second_color=WHITE, tile=2.0, line_width=0.3, fade_start=50.0, fade_end=60.0)
    camera = from_above()
    picture = Renderer(160, 160).render(camera, [], ground=ground)
    for point, expected in (((0.0, 1.0), 255), ((2.0, 1.0), 255), ((1.0, -2.0), 255), ((1.0, 1.0), 0)):
        column, row = camera.project((*point, 0.0), 160, 160)[0].astype(int)
        assert picture[row, column, 0] == expected


def test_ground_fades_into_the_background_and_is_not_seen_from_below():
    ground = GroundPlane(style="plain", color=RED, fade_start=1.0, fade_end=2.0)
    picture = Renderer(40, 40).render(from_above(), [], ground=ground, background=BLUE)
    assert is_color(picture[20, 20], RED)
    assert is_color(picture[0], BLUE).all()
    below = Camera((0, 0, -10), (0, 0, 0), up=(0, 1, 0))
    assert is_color(Renderer(40, 40).render(below, [], ground=ground, background=BLUE), BLUE).all()


def test_ground_hides_what_is_below_and_not_what_lies_on_it():
    ground = GroundPlane(style="plain", color=GREY, shadow=0.0, fade_start=50.0, fade_end=60.0)
    for height, seen in ((-0.1, False), (0.0, True)):
        mesh = plate(height, 1.0, color=RED, material=UNLIT)
        picture = Renderer(40, 40).render(from_above(), [mesh], ground=ground)
        assert is_color(picture[20, 20], RED) == seen


def test_background_goes_from_top_to_bottom():
    picture = Renderer(4, 200).render(from_above(), [], background=Background(top=(0, 0, 0), bottom=WHITE))
    light = brightness(picture)
    np.testing.assert_allclose(light[:, 0], (np.arange(200) + 0.5) / 200, atol=0.01)


def test_refine_makes_outlines_rounder():
    camera = Camera((0, -10, 0), (0, 0, 0), vertical_field_of_view=14.0)
    renderer = Renderer(200, 200)
    coarse = sphere_mesh((0, 0, 0), 1.0, subdivisions=1, color=WHITE, material=UNLIT)
    exact = np.pi / 99.0
    areas = []
    for refine in (0, 1, 2):
        mesh = Mesh(coarse.vertices, coarse.triangles, color=WHITE, material=UNLIT, refine=refine)
        picture = renderer.render(camera, [mesh], background=(0, 0, 0))
        side = 2 * np.tan(np.radians(7.0))
        areas.append(brightness(picture).mean() * side**2)
    assert abs(areas[1] - exact) < 0.5 * abs(areas[0] - exact)
    assert abs(areas[2] - exact) <= abs(areas[1] - exact)


def test_refined_triangles_leave_no_seam():
    coarse = sphere_mesh((0, 0, 0), 1.0, subdivisions=1)
    mesh = Mesh(coarse.vertices, coarse.triangles, color=WHITE, material=UNLIT, refine=2, opacity=0.5)
    camera = Camera((0.3, -3, 0.2), (0, 0, 0), vertical_field_of_view=20.0)
    picture = Renderer(80, 60).render(camera, [mesh], background=(0, 0, 0))
    assert len(np.unique(picture)) == 1
    assert brightness(picture)[0, 0] == pytest.approx(0.5, abs=0.01)


def test_both_triangles_of_an_edge_find_the_same_middle():
    from spatula_env.render.vertices import refine

    generator = np.random.default_rng(3)
    for _ in range(50):
        points, normals = np.zeros((10, 3)), np.zeros((10, 3))
        points[:4], normals[:4] = generator.normal(size=(2, 4, 3))
        triangles = np.array([[0, 1, 2], [1, 0, 3]], dtype=np.int32)
        out = np.zeros((8, 3), dtype=np.int32)
        end = refine(triangles, 0, 2, out, 0, 4, -np.inf, points, normals, np.zeros((10, 3)), np.zeros((10, 3)))
        assert end == 10
        np.testing.assert_array_equal(points[4], points[7])
        assert len(np.unique(points[4:], axis=0)) == 5


def test_refining_does_not_push_a_body_through_the_ground():
    box = box_mesh((2, 2, 2), (0, 0, 1))
    mesh = Mesh(box.vertices, box.triangles, color=RED, material=UNLIT, refine=1, two_sided=True)
    ground = GroundPlane(style="plain", color=BLUE, fade_start=50.0, fade_end=60.0)
    cut = Mesh(box.vertices, box.triangles, color=RED, material=UNLIT, refine=1, clip_plane=((0, 0, 0.5), (0, 0, 1)))
    assert is_color(Renderer(40, 40).render(from_above(), [cut], ground=ground)[20, 20], RED)
    assert is_color(Renderer(40, 40).render(from_above(), [mesh], ground=ground)[20, 20], RED)


def test_marks_stay_on_a_body_that_moves():
    # The same pixels, with the camera moved along: texture coordinates carry the marks.
    ball = sphere_mesh((0, 0, 0), 1.0, subdivisions=3)
    pictures = []
    for shift in (np.zeros(3), np.array([4.0, -2.0, 8.0])):
        mesh = Mesh(ball.vertices + shift, ball.triangles, material=WET_TISSUE, texture=ball.vertices)
        camera = Camera(tuple(np.array((3.0, -4.0, 2.0)) + shift), tuple(shift))
        pictures.append(Renderer(48, 48).render(camera, [mesh]).astype(int))
    np.testing.assert_allclose(pictures[0], pictures[1], atol=1)
    plain = Mesh(ball.vertices, ball.triangles, material=WET_TISSUE)
    unmarked = Renderer(48, 48).render(Camera((3, -4, 2), (0, 0, 0)), [plain]).astype(int)
    assert np.abs(unmarked - pictures[0]).max() > 5


def test_brush_marks_vary_across_and_not_along():
    plain = Material(metallic=1.0, specular=0.0, rim=0.0, grain=1.0)
    box = box_mesh((4, 4, 1), material=plain)
    camera = Camera((0, 0, 60), (0, 0, 0), up=(0, 1, 0), vertical_field_of_view=3.0)
    picture = Renderer(100, 100).render(camera, [box]).astype(int)[..., 0]
    assert picture.std(axis=0).mean() > 4 * picture.std(axis=1).mean()


@pytest.mark.parametrize("material", [MATTE, WET_TISSUE, BRUSHED_STEEL])
def test_materials_give_colors_in_range_from_every_side(material):
    for elevation in (-80, 0, 80):
        camera = Camera.orbit((0, 0, 0), 5, 40, elevation)
        mesh = sphere_mesh((0, 0, 0), 1.0, color=GREY, material=material)
        picture = Renderer(24, 24).render(camera, [mesh, arrow_mesh((0, 0, 1), (0, 0, 0.5))], background=(0, 0, 0))
        assert 10 < picture[12, 12].max() <= 255


def test_importing_the_package_loads_no_compiler():
    code = "import sys, spatula_env.render as render; print('numba' in sys.modules, 'Renderer' in dir(render))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]


def test_no_other_name_is_made_up():
    import spatula_env.render

    with pytest.raises(AttributeError, match="Rasterizer"):
        _ = spatula_env.render.Rasterizer
