"""Stresses at nodes and their relaxation, as instructions on rows of lanes, each the body of a loop over nodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba.extending import intrinsic

from spatula_env.sim.tissue.lanes import Build, Row, cross, dot
from spatula_env.sim.tissue.nodal import (
    BULK,
    C1,
    C2,
    GROWTH,
    MATERIAL_ROWS,
    NODE_COLUMNS,
    REST_PRESSURE,
    STABILISER,
    SYMMETRIC,
    cauchy_green,
    deformation,
    instructions,
    stiffening,
)

LEAST_VOLUME = 0.2
"""Least J by which the relaxing stress is divided: where tissue is compressed further, relaxation is not exact."""


def _emit_stress(
    build: Build,
    positions: Any,
    stresses: Any,
    overstresses: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    nodes: Any,
    materials: Any,
    node: Any,
    *,
    general: bool,
) -> None:
    def material(row: int) -> Row:
        return build.load(build.address(materials, None, row, MATERIAL_ROWS))

    f = deformation(build, positions, starts, neighbours, pairs, node)
    # Row i of the cofactors of F is the vector product of its other two rows.
    cofactors = [cross(f[(i + 1) % 3], f[(i + 2) % 3]) for i in range(3)]
    one, two = build.constant(1.0), build.constant(2.0)
    volume = dot(f[0], cofactors[0])
    flat = [entry for row in cofactors for entry in row]
    second = dot(flat, flat)
    # Beyond this growth, the stiffness of the pressure is limited to what the length of a substep allows.
    hold = one.least(material(GROWTH) / second)
    pressure = material(BULK) * (volume - one) - material(REST_PRESSURE)
    if not general:
        pressure = pressure * hold
        slope = material(C1) * two - material(STABILISER)
        stress = [[(slope * f[i][j]).plus(pressure, cofactors[i][j]) for j in range(3)] for i in range(3)]
    else:
        c = cauchy_green(f)
        first = (c[0][0] + c[1][1]) + c[2][2]
        slope = stiffening(build, material, first, second, volume)
        pressure = pressure.plus(build.constant(-6.0), slope) * hold
        of_second = (material(C2) + slope) * two * hold
        of_first = ((material(C1) + slope) * two - material(STABILISER)).plus(of_second, first)
        # F is multiplied by 2 s1 + 2 s2 (I1 - C) less what has relaxed.
        middle = [[-(of_second * c[i][j]) for j in range(3)] for i in range(3)]
        for k, (i, j) in enumerate(SYMMETRIC):
            middle[i][j] = middle[i][j] - build.load(build.address(overstresses, node, k, 6))
            middle[j][i] = middle[i][j]
        for k in range(3):
            middle[k][k] = middle[k][k] + of_first
        stress = [
            [dot(f[i], [middle[k][j] for k in range(3)]).plus(pressure, cofactors[i][j]) for j in range(3)]
            for i in range(3)
        ]
    share = build.number(nodes, node, 2, NODE_COLUMNS)
    for i in range(3):
        for j in range(3):
            build.store(stress[i][j] * share, build.address(stresses, node, 3 * i + j, 9))


def _emit_neo_hookean(build: Build, *given: Any) -> None:
    _emit_stress(build, *given, general=False)


def _emit_general(build: Build, *given: Any) -> None:
    _emit_stress(build, *given, general=True)


@intrinsic
def find_neo_hookean(
    typing_context: Any,
    lanes: Any,
    positions: Any,
    stresses: Any,
    overstresses: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    nodes: Any,
    materials: Any,
    node: Any,
) -> tuple[Any, Callable[..., Any]]:
    """Write a node's stress times its volume (N, 9, lanes), where c2 and c3 are zero and nothing relaxes."""
    return instructions(
        _emit_neo_hookean, lanes, positions, stresses, overstresses, starts, neighbours, pairs, nodes, materials, node
    )


@intrinsic
def find_stress(
    typing_context: Any,
    lanes: Any,
    positions: Any,
    stresses: Any,
    overstresses: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    nodes: Any,
    materials: Any,
    node: Any,
) -> tuple[Any, Callable[..., Any]]:
    """Write a node's stress times its volume (N, 9, lanes)."""
    return instructions(
        _emit_general, lanes, positions, stresses, overstresses, starts, neighbours, pairs, nodes, materials, node
    )


def _emit_relax(
    build: Build,
    positions: Any,
    overstresses: Any,
    histories: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    materials: Any,
    relaxation: Any,
    terms: Any,
    node: Any,
) -> None:
    def material(row: int) -> Row:
        return build.load(build.address(materials, None, row, MATERIAL_ROWS))

    f = deformation(build, positions, starts, neighbours, pairs, node)
    cofactors = [cross(f[(i + 1) % 3], f[(i + 2) % 3]) for i in range(3)]
    volume = dot(f[0], cofactors[0])
    c = cauchy_green(f)
    first = (c[0][0] + c[1][1]) + c[2][2]
    flat = [entry for row in cofactors for entry in row]
    two, slope = build.constant(2.0), stiffening(build, material, first, dot(flat, flat), volume)
    of_second = (material(C2) + slope) * two
    of_first = ((material(C1) + slope) * two).plus(of_second, first)
    # The inverse of C is the product of the transposed cofactors and the cofactors, divided by J squared.
    inward = -(material(REST_PRESSURE).plus(build.constant(6.0), slope) / volume.most(build.constant(LEAST_VOLUME)))
    stress = []
    for i, j in SYMMETRIC:
        entry = inward * dot([cofactors[k][i] for k in range(3)], [cofactors[k][j] for k in range(3)])
        entry = entry.plus(-of_second, c[i][j])
        stress.append(entry + of_first if i == j else entry)
    sums = build.sums(6)
    with build.each(build.whole(0), terms) as term:
        keep, share = (build.load(build.address(relaxation, term, row, 2)) for row in range(2))
        place = build.builder.add(build.builder.mul(node, terms), term)
        for k in range(6):
            at = build.address(histories, place, k, 6)
            # The history of a term approaches the stress exponentially.
            history = stress[k].plus(keep, build.load(at) - stress[k])
            build.store(history, at)
            sums[k].add(share, history)
    for k in range(6):
        build.store(sums[k].row, build.address(overstresses, node, k, 6))


@intrinsic
def relax_node(
    typing_context: Any,
    lanes: Any,
    positions: Any,
    overstresses: Any,
    histories: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    materials: Any,
    relaxation: Any,
    terms: Any,
    node: Any,
) -> tuple[Any, Callable[..., Any]]:
    """Let a node's stress relax for a step: write the histories (N, terms, 6, lanes) and their sum (N, 6, lanes)."""
    return instructions(
        _emit_relax, lanes, positions, overstresses, histories, starts, neighbours, pairs, materials, relaxation,
        terms, node,
    )  # fmt: skip


def _emit_deformation(
    build: Build, positions: Any, deformations: Any, starts: Any, neighbours: Any, pairs: Any, node: Any
) -> None:
    for i, row in enumerate(deformation(build, positions, starts, neighbours, pairs, node)):
        for j, entry in enumerate(row):
            build.store(entry, build.address(deformations, node, 3 * i + j, 9))


@intrinsic
def find_deformation(
    typing_context: Any,
    lanes: Any,
    positions: Any,
    deformations: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    node: Any,
) -> tuple[Any, Callable[..., Any]]:
    """Write a node's deformation gradient (N, 9, lanes)."""
    return instructions(_emit_deformation, lanes, positions, deformations, starts, neighbours, pairs, node)
