"""Spatula/Palpate-v0, for one agent and for many."""

from __future__ import annotations

from spatula_env import scenes
from spatula_env.envs.control import ALL_SIX, TRANSLATION, ControlLayout
from spatula_env.envs.settings import Definition
from spatula_env.envs.spatula_env import SpatulaEnv
from spatula_env.envs.vector import SpatulaVectorEnv
from spatula_env.tasks.palpate import PalpateConfig, PalpateTask

PALPATE = Definition(
    name="palpate",
    scene=scenes.palpate,
    task=PalpateTask,
    config=PalpateConfig,
    # The cube reaches 76 mm above the organ's top and 26 mm below it.
    workspace_height=0.025,
    controls={
        "velocity": ControlLayout(rotations="xy", max_turn=0.6),
        "velocity_6d": ALL_SIX,
        # A plate that stays level touches a round organ at its top, or with a rim.
        "velocity_level": TRANSLATION,
    },
    # A path is felt with 0.21 N at most.
    defaults={"max_speed": 0.05, "max_force": 0.6},
    former_options={1: {"control": ("velocity", {"velocity": "velocity_level"})}},
)
"""A spatula over a sphere that is held from below."""


class PalpateEnv(SpatulaEnv):
    r"""Slide along a path on the organ with a force in a band, and stop at its end.

    ## Description
    A thin steel spatula, 20 x 20 x 2.5 mm, hovers flat over a soft organ of 60 mm radius that is held from below and
    as stiff as brain tissue. The agent moves the spatula. It has to touch the organ where a path of 30 to 40 mm
    begins, to slide along it, and to press all the while with a force in a band (30 mN to either side of a middle of
    0.1 to 0.18 N), as one feels for what is under a surface; and to stay at the path's end, with that force, for half a
    second.

    A piece of the path, which has 40 of equal length, is *felt* once the spatula's middle has passed over it, no more
    than 3 mm aside, with a normal force in the band. A given share of the path is to be felt (80 to 90 %), in any order
    and as often as it takes. The normal force is that part of the contact force which is perpendicular to the
    spatula's faces. The organ is round, slips under the spatula and is stiffer in some places than in others, so the
    force has to be regulated.

    `SpatulaEnv` tells what all environments have in common.

    ## Action Space
    The action space is a `Box(-1, 1, (3,), float32)`: the spatula's velocity as a fraction of `max_speed`. It does not
    turn; with `control="velocity_6d"`, which has six numbers, it does.

    | Num | Action                           | Min | Max | Name       | Falcon | Unit                   |
    | --- | -------------------------------- | --- | --- | ---------- | ------ | ---------------------- |
    | 0   | velocity to the operator's right | -1  | 1   | velocity_x | x      | `max_speed` (0.05 m/s) |
    | 1   | velocity away from the operator  | -1  | 1   | velocity_y | -z     | `max_speed` (0.05 m/s) |
    | 2   | velocity upwards                 | -1  | 1   | velocity_z | y      | `max_speed` (0.05 m/s) |

    The workspace's middle is 25 mm above the organ's top at rest.

    ## Observation Space
    The observation is a `Box((101,), float32)` of these parts:

    | Num   | Observation                                           | Min     | Max    | Name             | Unit |
    | ----- | ----------------------------------------------------- | ------- | ------ | ---------------- | ---- |
    | 0-2   | position of the spatula's middle (x, y, z)            | -0.0508 | 0.0508 | tool_position    | m    |
    | 3-5   | velocity of the spatula in the last step              | -0.05   | 0.05   | tool_velocity    | m/s  |
    | 6-8   | mean force on the spatula in the last step            | -10     | 10     | contact_force    | N    |
    | 9-11  | its mean torque about the spatula's middle            | -0.2    | 0.2    | contact_torque   | N m  |
    | 12    | share of the lower face's nodes in contact            | 0       | 1      | contact_share    | 1    |
    | 13    | the same of the upper face                            | 0       | 1      | contact_share    | 1    |
    | 14    | deepest contact, before the organ gives way           | 0       | 0.05   | contact_depth    | m    |
    | 15    | greatest contact pressure on a node in the last step  | 0       | 20000  | contact_pressure | Pa   |
    | 16    | greatest mean pressure on a face                      | 0       | 20000  | contact_pressure | Pa   |
    | 17-64 | displacement of 16 nodes of the organ (x, y, z)       | -0.1    | 0.1    | landmarks        | m    |
    | 65-79 | 5 points of the path from the underside (x, y, z)     | -0.15   | 0.15   | path_ahead       | m    |
    | 80    | farthest place on the path that has been felt         | 0       | 1      | progress         | 1    |
    | 81-90 | share felt of each tenth of the path                  | 0       | 1      | felt             | 1    |
    | 91    | force perpendicular to the spatula's faces            | -5      | 5      | normal_force     | N    |
    | 92    | share of the path that is to be felt                  | 0       | 1      | goal             | 1    |
    | 93-94 | place of the path's end (x, y)                        | -0.0508 | 0.0508 | goal             | m    |
    | 95    | middle of the force's band                            | -5      | 5      | goal             | N    |
    | 96    | share to be felt minus share felt                     | -1      | 1      | error            | 1    |
    | 97-98 | path's end minus place of the spatula (x, y)          | -0.1016 | 0.1016 | error            | m    |
    | 99    | middle of the band minus normal force                 | -10     | 10     | error            | N    |
    | 100   | for how long the goal has been held, of what is asked | 0       | 1      | hold_progress    | 1    |

    The 5 points of the path lie 0, 1/8, 1/4, 3/8 and 1/2 of its length ahead of the farthest place that has been felt,
    on the organ at rest, or at the path's end.

    With `reward="sparse"` goals are (share, x, y, force). The share achieved is that felt so far, in the band of the
    episode.

    ## Rewards
    A step is *within tolerance* if as much of the path has been felt as is asked for, the spatula's middle is within
    2 mm of the path's end, horizontally, and the normal force is in the band.

    The terms of the dense reward, with $t(d, s) = 1 - \tanh(d / s)$:

    | Name   | Weight | Term                                                                             |
    | ------ | ------ | -------------------------------------------------------------------------------- |
    | reach  | 0.1    | $t(d, 20\,mm)$, d from the spatula's underside to the first of the 5 points      |
    | force  | 0.1    | $t(f, 0.1\,N) \, t(p, 3\,mm)$, f the force's error, p the distance from the path |
    | felt   | 0.3    | share felt by share asked for, 1 at most                                         |
    | hold   | 0.5    | 1 within tolerance, 0 elsewhere                                                  |
    | action | -0.01  | squared length of the action                                                     |

    ## Starting State
    The organ is at rest. The path's ends are 30 to 40 mm apart, in any direction, the middle between them in a disc of
    4 mm radius around the organ's axis; half way, the path is up to 4 mm to the left or to the right of the straight
    line. Share and band are uniform in their ranges. The spatula is at rest at a place uniform in a disc of 10 mm
    radius around the path's beginning, its underside uniform in 5 to 15 mm above the organ's top.

    `reset(options={"goal": (share, x, y, force), "tool_position": (x, y, z)})` replaces either of them; the path
    then ends there, and comes from beyond the organ's axis.

    ## Episode End
    Success is to have been within tolerance for 10 steps (0.5 s) in a row.

    ## Info
    Besides what every environment tells (see `SpatulaEnv`):

    | Key            | Meaning                                                         | Unit |
    | -------------- | --------------------------------------------------------------- | ---- |
    | `share`        | share of the path that has been felt                            | 1    |
    | `progress`     | farthest place on the path that has been felt, by its length    | 1    |
    | `normal_force` | force perpendicular to the spatula's faces                      | N    |
    | `force_error`  | distance of it from the band's middle                           | N    |
    | `end_distance` | horizontal distance of the spatula's middle from the path's end | m    |

    ## Arguments
    Those of `SpatulaEnv`; `task` changes fields of `PalpateConfig`. Other defaults have

    | Parameter   | Type               | Default | Description                          |
    | ----------- | ------------------ | ------- | ------------------------------------ |
    | `max_speed` | **float**          | `0.05`  | Greatest speed along each axis [m/s] |
    | `max_force` | **float \| None**  | `0.6`   | With a greater one no tool pushes on |

    ## Version History
    * v0: first version.
    """

    definition = PALPATE


class PalpateVectorEnv(SpatulaVectorEnv):
    """`PalpateEnv` in many worlds at once, as `gymnasium.make_vec` makes it; `SpatulaVectorEnv` has the arguments."""

    definition = PALPATE
