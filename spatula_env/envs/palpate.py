"""Spatula/Palpate-v0, for one agent and for many."""

from __future__ import annotations

from spatula_env import scenes
from spatula_env.envs.control import ALL_SIX, TRANSLATION, ControlLayout
from spatula_env.envs.levels import HARD_RANGES, Level, hard_level, standard_level
from spatula_env.envs.observed_ranges import ObservedRanges
from spatula_env.envs.settings import Definition, OwnOrgan
from spatula_env.envs.spatula_env import SpatulaEnv
from spatula_env.envs.vector import SpatulaVectorEnv
from spatula_env.scenes.material import LENIENT_STRAIN
from spatula_env.tasks.palpate import PalpateConfig, PalpateTask
from spatula_env.tasks.palpate_anywhere import PalpateAnywhereTask

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
    # More than experts, haste and random motion have met, but for the greatest pressure. A level plate is touched from
    # below alone.
    observed=ObservedRanges(
        force=1.5,
        torque=0.01,
        contact_depth=0.02,
        mean_pressure=3e3,
        displacement=0.03,
        untouched={"velocity_level": (1,)},
        face_count=2,
    ),
    own_organ=OwnOrgan(scenes.organ_from_above, PalpateAnywhereTask),
    # A force is to be kept within a few hundredths of a newton, which a millimetre of breathing changes by as much.
    levels={
        "easy": Level(),
        "standard": standard_level(),
        "hard": hard_level(
            {
                **HARD_RANGES,
                "stiffness": (0.6, 1.5),
                "breathing": (0.0, 0.0004),
                "pulse": (0.0, 0.0001),
                "sensor_noise": (0.0, 1.0),
            },
            task={"start_radius": 0.018, "start_height_range": (0.005, 0.03)},
            strain_limit=LENIENT_STRAIN,
        ),
    },
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

    A piece of the path, which has 40 of equal length, is *felt* once the centre of pressure has passed over it, no more
    than 3 mm aside, with a normal force in the band. A given share of the path is to be felt (80 to 90 %), in any order
    and as often as it takes. The normal force is that part of the contact force which is perpendicular to the
    spatula's faces, and the centre of pressure is where on the lower face it acts, as force and torque tell. The path
    is on the organ and goes with it. A flat face touches a round organ where both are equally steep: the spatula has to
    be tilted as it slides. The organ slips under the spatula and is stiffer in some places than in others, so force and
    tilt have to be regulated.

    `SpatulaEnv` tells what all environments have in common.

    ## Action Space
    The action space is a `Box(-1, 1, (5,), float32)`: the spatula's velocity as a fraction of `max_speed`, and the
    rates of its tilt as fractions of `max_rotation_rate`. The tilt is stopped at 0.6 rad.

    | Num | Action                            | Min | Max | Name       | Falcon | Unit                            |
    | --- | --------------------------------- | --- | --- | ---------- | ------ | ------------------------------- |
    | 0   | velocity to the operator's right  | -1  | 1   | velocity_x | x      | `max_speed` (0.05 m/s)          |
    | 1   | velocity away from the operator   | -1  | 1   | velocity_y | -z     | `max_speed` (0.05 m/s)          |
    | 2   | velocity upwards                  | -1  | 1   | velocity_z | y      | `max_speed` (0.05 m/s)          |
    | 3   | rate of the tilt about x          | -1  | 1   | rotation_x |        | `max_rotation_rate` (1.0 rad/s) |
    | 4   | rate of the tilt about y          | -1  | 1   | rotation_y |        | `max_rotation_rate` (1.0 rad/s) |

    A positive tilt about x raises the far edge, and one about y lowers the right one. With `control="velocity_6d"`
    there are six numbers: the rate about z as well. With `control="velocity_level"` there are three, and the spatula
    stays level: it then touches the organ at its top, or with a rim, and feels no path.

    The workspace's middle is 25 mm above the organ's top at rest.

    ## Observation Space
    The observation is a `Box((105,), float32)` of these parts:

    | Num     | Observation                                           | Min     | Max    | Name               | Unit  |
    | ------- | ----------------------------------------------------- | ------- | ------ | ------------------ | ----- |
    | 0-2     | position of the spatula's middle (x, y, z)            | -0.0508 | 0.0508 | tool_position      | m     |
    | 3-5     | velocity of the spatula in the last step              | -0.05   | 0.05   | tool_velocity      | m/s   |
    | 6-7     | tilt: rotation about x and y                          | -0.6    | 0.6    | tool_orientation   | rad   |
    | 8-9     | rate of the tilt in the last step                     | -1      | 1      | tool_rotation_rate | rad/s |
    | 10-12   | mean force on the spatula in the last step            | -1.5    | 1.5    | contact_force      | N     |
    | 13-15   | its mean torque about the spatula's middle            | -0.01   | 0.01   | contact_torque     | N m   |
    | 16      | share of the lower face's nodes in contact            | 0       | 1      | contact_share      | 1     |
    | 17      | the same of the upper face                            | 0       | 1      | contact_share      | 1     |
    | 18      | deepest contact, before the organ gives way           | 0       | 0.02   | contact_depth      | m     |
    | 19      | greatest contact pressure on a node in the last step  | 0       | 20000  | contact_pressure   | Pa    |
    | 20      | greatest mean pressure on a face                      | 0       | 3000   | contact_pressure   | Pa    |
    | 21-68   | displacement of 16 nodes of the organ (x, y, z)       | -0.03   | 0.03   | landmarks          | m     |
    | 69-83   | 5 points of the path from the underside (x, y, z)     | -0.09   | 0.09   | path_ahead         | m     |
    | 84      | farthest place on the path that has been felt         | 0       | 1      | progress           | 1     |
    | 85-94   | share felt of each tenth of the path                  | 0       | 1      | felt               | 1     |
    | 95      | force perpendicular to the spatula's faces            | -1      | 1      | normal_force       | N     |
    | 96      | share of the path that is to be felt                  | 0       | 1      | goal               | 1     |
    | 97-98   | place of the path's end (x, y)                        | -0.0508 | 0.0508 | goal               | m     |
    | 99      | middle of the force's band                            | -1      | 1      | goal               | N     |
    | 100     | share to be felt minus share felt                     | -1      | 1      | error              | 1     |
    | 101-102 | path's end minus centre of pressure (x, y)            | -0.1016 | 0.1016 | error              | m     |
    | 103     | middle of the band minus normal force                 | -2      | 2      | error              | N     |
    | 104     | for how long the goal has been held, of what is asked | 0       | 1      | hold_progress      | 1     |

    The 5 points of the path lie 0, 1/8, 1/4, 3/8 and 1/2 of its length ahead of the farthest place that has been felt,
    where the organ has them now, or at the path's end. The way to them is that from the middle of the lower face.

    Goals are (share, x, y, force). The place achieved is the centre of pressure, less by how far the path's end has
    gone with the organ. The share is felt along the episode's path and in its band, so there is no hindsight: with
    `reward="sparse"` observations are the same.

    Sensors know `tool_position`, `tool_velocity`, `tool_orientation`, `tool_rotation_rate`, `contact_force`,
    `contact_torque`, `normal_force` and `goal`; all else is privileged. Of the path sensors are told the end alone: the
    rest of it is not in pictures either, so that who has these parts only has to search for it.
    With `control="velocity_level"` there is no number for the upper face.

    ## Rewards
    A step is *within tolerance* if as much of the path has been felt as is asked for, the centre of pressure is within
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

    Costs are counted from a loading of 1.8 N/s and a pressure of 2.67 kPa on; safe
    success costs 20 ms at most.

    ## Info
    Besides what every environment tells (see `SpatulaEnv`):

    | Key             | Meaning                                                           | Unit |
    | --------------- | ----------------------------------------------------------------- | ---- |
    | `share`         | share of the path that has been felt                              | 1    |
    | `progress`      | farthest place on the path that has been felt, by its length      | 1    |
    | `normal_force`  | force perpendicular to the spatula's faces                        | N    |
    | `force_error`   | distance of it from the band's middle                             | N    |
    | `path_distance` | horizontal distance of the centre of pressure from the path       | m    |
    | `end_distance`  | horizontal distance of the centre of pressure from the path's end | m    |

    Where nothing is touched, `path_distance` is that of the lower face's middle from the first of the 5 points.

    ## An Organ of One's Own
    With `organ="FILE.npz"`, a file of `spatula organ prepare`, the organ stands on the ground and the workspace is over
    that part of it of which most can be felt from above. Paths are drawn from all of the surface that the spatula
    reaches, where it is no steeper than 29 degrees, 15 mm thick and smooth enough to lie against. Observations have one
    more part, `path_normals` (15), the normals at the five points of `path_ahead`. Budget and limits are those of the
    sphere.

    ## Arguments
    Those of `SpatulaEnv`; `task` changes fields of `PalpateConfig`. Other defaults have

    | Parameter   | Type               | Default | Description                          |
    | ----------- | ------------------ | ------- | ------------------------------------ |
    | `max_speed` | **float**          | `0.05`  | Greatest speed along each axis [m/s] |
    | `max_force` | **float \| None**  | `0.6`   | With a greater one no tool pushes on |

    ## Version History
    * v0: first version; the task has its second [definition](../definitions.md).
    """

    definition = PALPATE


class PalpateVectorEnv(SpatulaVectorEnv):
    """`PalpateEnv` in many worlds at once, as `gymnasium.make_vec` makes it; `SpatulaVectorEnv` has the arguments."""

    definition = PALPATE
