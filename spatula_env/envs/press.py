"""Spatula/Press-v0, for one agent and for many."""

from __future__ import annotations

from spatula_env import scenes
from spatula_env.envs.levels import Level, hard_level, standard_level
from spatula_env.envs.observed_ranges import ObservedRanges
from spatula_env.envs.settings import Definition, OwnOrgan
from spatula_env.envs.spatula_env import SpatulaEnv
from spatula_env.envs.vector import SpatulaVectorEnv
from spatula_env.scenes.material import LENIENT_STRAIN
from spatula_env.tasks.press import PressConfig, PressTask
from spatula_env.tasks.press_anywhere import PressAnywhereTask

PRESS = Definition(
    name="press",
    scene=scenes.seed,
    task=PressTask,
    config=PressConfig,
    # The cube reaches 76 mm above the organ's top and 26 mm below it.
    workspace_height=0.025,
    # More than experts, haste and random motion have met, but for pressures and for a sphere that has rolled away. A
    # plate that lies flat is touched from below alone.
    observed=ObservedRanges(
        force=1.5,
        torque=0.01,
        contact_depth=0.015,
        mean_pressure=4e3,
        displacement=0.1,
        untouched={"velocity": (1,)},
        face_count=2,
    ),
    own_organ=OwnOrgan(scenes.organ_from_above, PressAnywhereTask, {"max_force": 3.0}),
    # Deeper, the rim of a flat spatula exceeds the pressures that tissue bears, however careful the agent is.
    levels={
        "easy": Level(),
        "standard": standard_level(task={"depth_range": (0.003, 0.005), "place_radius": 0.01}),
        "hard": hard_level(
            task={
                "depth_range": (0.0025, 0.006),
                "place_radius": 0.012,
                "start_radius": 0.03,
                "start_height_range": (0.005, 0.045),
            },
            strain_limit=LENIENT_STRAIN,
        ),
    },
)
"""A spatula over a sphere."""


class PressEnv(SpatulaEnv):
    r"""Press the organ to a depth at a place, and hold it there.

    ## Description
    A thin steel spatula, 20 x 20 x 2.5 mm, hovers flat over a soft organ of 60 mm radius and the stiffness of
    brain tissue, which rests on the ground; its density is a sixth of that, and with an organ of another mesh
    forces hold only if it was calibrated. The agent moves the spatula. It has to push the organ's surface down to a
    given depth (5 to 18 mm) at a given place (within 15 mm of the organ's axis), and to keep it
    there for half a second.

    Depth is measured on the organ: it is the height that the surface would have at the spatula's place if nothing
    pressed on it, where the organ lies now, minus the height that it has. It counts while the spatula's lower face
    presses on the organ with 20 mN at least, and is zero without. The organ sinks, sways and gives way around the
    spatula: in the middle, its surface goes up to 3 mm deeper than the spatula does, and how much depends on the place.
    The depth has to be regulated.

    `SpatulaEnv` tells what all environments have in common.

    ## Action Space
    The action space is a `Box(-1, 1, (3,), float32)`: the spatula's velocity as a fraction of `max_speed`. It does not
    turn; with `control="velocity_6d"`, which has six numbers, it does.

    | Num | Action                           | Min | Max | Name       | Falcon | Unit                  |
    | --- | -------------------------------- | --- | --- | ---------- | ------ | --------------------- |
    | 0   | velocity to the operator's right | -1  | 1   | velocity_x | x      | `max_speed` (0.1 m/s) |
    | 1   | velocity away from the operator  | -1  | 1   | velocity_y | -z     | `max_speed` (0.1 m/s) |
    | 2   | velocity upwards                 | -1  | 1   | velocity_z | y      | `max_speed` (0.1 m/s) |

    The workspace's middle is 25 mm above the organ's top at rest.

    ## Observation Space
    The observation is a `Box((71,), float32)` of these parts:

    | Num   | Observation                                           | Min     | Max    | Name             | Unit |
    | ----- | ----------------------------------------------------- | ------- | ------ | ---------------- | ---- |
    | 0-2   | position of the spatula's middle (x, y, z)            | -0.0508 | 0.0508 | tool_position    | m    |
    | 3-5   | velocity of the spatula in the last step              | -0.1    | 0.1    | tool_velocity    | m/s  |
    | 6-8   | mean force on the spatula in the last step            | -1.5    | 1.5    | contact_force    | N    |
    | 9-11  | mean torque on it about its middle                    | -0.01   | 0.01   | contact_torque   | N m  |
    | 12    | share of the lower face's nodes in contact            | 0       | 1      | contact_share    | 1    |
    | 13    | deepest contact, before the organ gives way           | 0       | 0.015  | contact_depth    | m    |
    | 14    | greatest pressure in the last step                    | 0       | 20000  | contact_pressure | Pa   |
    | 15    | mean pressure on the face that is pressed most        | 0       | 4000   | contact_pressure | Pa   |
    | 16-63 | displacement of 16 nodes of the organ (x, y, z)       | -0.1    | 0.1    | landmarks        | m    |
    | 64-65 | place asked for (x, y)                                | -0.0508 | 0.0508 | goal             | m    |
    | 66    | depth asked for                                       | -0.03   | 0.06   | goal             | m    |
    | 67-68 | place asked for minus place of the spatula            | -0.1016 | 0.1016 | error            | m    |
    | 69    | depth asked for minus depth there                     | -0.09   | 0.09   | error            | m    |
    | 70    | for how long the goal has been held, of what is asked | 0       | 1      | hold_progress    | 1    |

    The organ lies free: who pushes it aside can roll it away, and then displacements stay at their bounds, and no depth
    is achieved. With `control="velocity_6d"` there is a number for the upper face too, which a level spatula's organ
    does not touch.

    Sensors know `tool_position`, `tool_velocity`, `contact_force`, `contact_torque` and `goal`; all else is privileged.

    With `reward="sparse"` goals are (x, y, depth).

    ## Rewards
    A step is *within tolerance* if the spatula's middle is within 2 mm of the place, horizontally, and the
    depth is within 1 mm of the goal's.

    The terms of the dense reward, with $t(d, s) = 1 - \tanh(d / s)$:

    | Name   | Weight | Term                                                               |
    | ------ | ------ | ------------------------------------------------------------------ |
    | reach  | 0.25   | $t(d, 20\,mm)$, d from the spatula's underside to the target point |
    | depth  | 0.25   | $t(d, 3\,mm) \, t(p, 3\,mm)$, d the depth's error, p the place's   |
    | hold   | 0.5    | 1 within tolerance, 0 elsewhere                                    |
    | force  | -0.002 | magnitude of the contact force [N]                                 |
    | action | -0.01  | squared length of the action                                       |

    ## Starting State
    The organ is at rest. The place is uniform in a disc of 15 mm radius around the organ's axis, or around `center`
    of `PressConfig`, which an organ with a hole there needs; the depth is
    uniform in 5 to 18 mm. The spatula is at rest at a place uniform in a disc of 20 mm radius, its underside
    uniform in 10 to 30 mm above the organ's top.

    `reset(options={"goal": (x, y, depth), "tool_position": (x, y, z)})` replaces either of them [m].

    ## Episode End
    Success is to have been within tolerance for 10 steps (0.5 s) in a row.

    Costs are counted from a loading of 2.6 N/s and a pressure of 2.67 kPa and 0.45 kPa more for each millimetre of
    depth on; safe success costs 20 ms at most.

    ## Info
    Besides what every environment tells (see `SpatulaEnv`): `depth`, `depth_error` and `place_error` [m].

    ## An Organ of One's Own
    With `organ="FILE.npz"`, a file of `spatula organ prepare`, the organ stands on the ground and the workspace is over
    that part of it of which most can be pressed from above. Places are drawn from all of the surface that the spatula
    reaches: no steeper than 45 degrees (8 if the organ lies free), smooth enough, and free on the way down. The spatula
    is turned to the surface's normal there, starts within 20 mm of that line and 10 to 30 mm above the surface, and is
    to press along it. The depth is the mean under the spatula, along the normal, and at most 0.3 of the organ's
    thickness or of the distance from what is held. Depth and place are measured across and along the normal:
    `error` tells by how much the spatula is off the line, turned into the horizontal. Observations have two more parts,
    `place_position` (3) [m] and `place_normal` (3), `max_force` is 3 N, and there is no goal interface, as the normal
    belongs to the place. Budget and limits are those of the sphere.

    ## Arguments
    Those of `SpatulaEnv`; `task` changes fields of `PressConfig`.

    ## Version History
    * v0: first version; the task has its second [definition](../definitions.md).
    """

    definition = PRESS


class PressVectorEnv(SpatulaVectorEnv):
    """`PressEnv` in many worlds at once, as `gymnasium.make_vec` makes it; `SpatulaVectorEnv` has the arguments."""

    definition = PRESS
