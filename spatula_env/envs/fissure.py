"""Spatula/Fissure-v0, for one agent and for many."""

from __future__ import annotations

from spatula_env import scenes
from spatula_env.envs.control import ControlLayout
from spatula_env.envs.levels import HARD_RANGES, Level, hard_level, standard_level
from spatula_env.envs.observed_ranges import ObservedRanges
from spatula_env.envs.settings import Definition, OwnOrgan
from spatula_env.envs.spatula_env import SpatulaEnv
from spatula_env.envs.vector import SpatulaVectorEnv
from spatula_env.tasks.fissure import FissureConfig, FissureTask
from spatula_env.tasks.fissure_anywhere import FissureAnywhereTask

FISSURE = Definition(
    name="fissure",
    scene=scenes.fissure,
    task=FissureTask,
    config=FissureConfig,
    # The cube reaches 76 mm above the organ's top and 26 mm below it.
    workspace_height=0.025,
    # Two millimetres above the fissure's floor, which is held.
    stop_height=0.03,
    controls={
        "velocity": ControlLayout(rotations="x", max_turn=0.6),
        "velocity_6d": ControlLayout(rotations="xyz", max_turn=0.6),
    },
    # A wall is moved aside with 0.2 N at most.
    defaults={"max_speed": 0.05, "max_force": 0.25},
    # More than experts, haste and random motion have met, but for pressures. The fissure is not as deep as the blade is
    # high.
    observed=ObservedRanges(
        force=0.6,
        torque=0.008,
        contact_depth=0.02,
        peak_pressure=15e3,
        mean_pressure=3e3,
        displacement=0.03,
        untouched={"velocity": (5,)},
        face_count=6,
    ),
    levels={
        "easy": Level(),
        "standard": standard_level(),
        # A wall twice as stiff as usual cannot be moved aside with the greatest force.
        "hard": hard_level(
            {**HARD_RANGES, "stiffness": (0.5, 1.5)},
            task={"start_offset": 0.015, "start_height_range": (0.004, 0.025), "start_tilt": 0.2},
        ),
    },
    own_organ=OwnOrgan(scenes.organ_with_fissure, FissureAnywhereTask, {"max_force": 0.6}),
)
"""A blade on edge above a fissure."""


class FissureEnv(SpatulaEnv):
    r"""Enter a fissure edge-on, open it, and hold it open until a target on its floor is seen.

    ## Description
    A thin steel spatula, 20 mm wide, 40 mm high and 2.5 mm thick, stands on edge above a soft organ with a fissure 60
    mm long, 32 mm deep and 5 mm wide, about as large as the lateral fissure of the brain. The organ is held at its base
    and under the fissure's floor. On the floor lies a target, a flat patch of 12 x 2 mm. Someone looks at it from
    above, as through an operating microscope, along a line of sight that is tilted towards one of the walls by 0.18 to
    0.3 rad (10 to 17 degrees): that wall hides the target. The agent has to enter the fissure and to lean the blade
    against the wall, so that 80 to 90 % of the target is seen, and to keep it there for half a second.

    What is seen is decided by parallel rays from 5 x 21 points of the target, 2 mm above the lowest line of the floor,
    towards the eye: those count that meet neither the organ nor the blade. Nothing is seen at rest, nor past a blade
    that is merely in the fissure: it has to be tilted like the line of sight, and the wall with it.

    `SpatulaEnv` tells what all environments have in common.

    ## Action Space
    The action space is a `Box(-1, 1, (4,), float32)`: velocities of the blade as fractions of `max_speed`, and the rate
    of its tilt as a fraction of `max_rotation_rate`. The tilt is stopped at 0.6 rad to either side. The blade turns
    about its middle, 20 mm above its lower edge.

    | Num | Action                                 | Min | Max | Name       | Falcon | Unit                            |
    | --- | -------------------------------------- | --- | --- | ---------- | ------ | ------------------------------- |
    | 0   | velocity to the operator's right       | -1  | 1   | velocity_x | x      | `max_speed` (0.05 m/s)          |
    | 1   | velocity away from the operator        | -1  | 1   | velocity_y | -z     | `max_speed` (0.05 m/s)          |
    | 2   | velocity upwards                       | -1  | 1   | velocity_z | y      | `max_speed` (0.05 m/s)          |
    | 3   | rate of the tilt, top to the operator  | -1  | 1   | rotation_x |        | `max_rotation_rate` (1.0 rad/s) |

    The fissure runs along x, to the operator's right. With `control="velocity_6d"` there are six numbers: the rates
    about y and z as well, as `rotation_y` and `rotation_z`; orientation and its rate have three numbers each then.

    The workspace's middle is 25 mm above the organ's top at rest.

    ## Observation Space
    The observation is a `Box((80,), float32)` of these parts:

    | Num   | Observation                                             | Min     | Max    | Name               | Unit  |
    | ----- | ------------------------------------------------------- | ------- | ------ | ------------------ | ----- |
    | 0-2   | position of the blade's middle (x, y, z)                | -0.0508 | 0.0508 | tool_position      | m     |
    | 3-5   | velocity of the blade's middle in the last step         | -0.05   | 0.05   | tool_velocity      | m/s   |
    | 6     | tilt: rotation about x, its top to the operator         | -0.6    | 0.6    | tool_orientation   | rad   |
    | 7     | rate of the tilt in the last step                       | -1      | 1      | tool_rotation_rate | rad/s |
    | 8-10  | mean force on the blade in the last step                | -0.6    | 0.6    | contact_force      | N     |
    | 11-13 | mean torque on it about its middle                      | -0.008  | 0.008  | contact_torque     | N m   |
    | 14    | share of the nodes in contact: face away from operator  | 0       | 1      | contact_share      | 1     |
    | 15    | the same of the face towards the operator               | 0       | 1      | contact_share      | 1     |
    | 16-17 | of the narrow sides: left, right                        | 0       | 1      | contact_share      | 1     |
    | 18    | of the lower edge                                       | 0       | 1      | contact_share      | 1     |
    | 19    | deepest contact, before the organ gives way             | 0       | 0.02   | contact_depth      | m     |
    | 20    | greatest pressure in the last step                      | 0       | 15000  | contact_pressure   | Pa    |
    | 21    | mean pressure on the face that is pressed most          | 0       | 3000   | contact_pressure   | Pa    |
    | 22-69 | displacement of 16 nodes of the organ (x, y, z)         | -0.03   | 0.03   | landmarks          | m     |
    | 70-72 | from the blade's lower edge to the target (x, y, z)     | -0.1    | 0.1    | target_offset      | m     |
    | 73    | where the target is, from the fissure's middle          | -0.0508 | 0.0508 | goal               | m     |
    | 74    | tilt of the line of sight, like the blade's             | -0.6    | 0.6    | goal               | rad   |
    | 75    | share of the target that is to be seen                  | 0       | 1      | goal               | 1     |
    | 76    | the target's place minus the blade's, along the fissure | -0.1016 | 0.1016 | error              | m     |
    | 77    | tilt of the line of sight minus the blade's             | -1.2    | 1.2    | error              | rad   |
    | 78    | share that is to be seen minus share that is seen       | -1      | 1      | error              | 1     |
    | 79    | for how long the goal has been held, of what is asked   | 0       | 1      | hold_progress      | 1     |

    Goals are (place, view, exposure). What is achieved is the blade's place along the fissure, the blade's tilt, and
    the share of the target that is seen. That depends on where the target is and on the line of sight, so there is no
    hindsight: with `reward="sparse"` observations are the same.

    With `control="velocity_6d"` there is a number for the upper edge too, which does not get into the fissure else.

    Sensors know `tool_position`, `tool_velocity`, `tool_orientation`, `tool_rotation_rate`, `contact_force`,
    `contact_torque` and `goal`; all else is privileged.

    ## Rewards
    A step is *within tolerance* if at least the share asked for is seen, while the blade's lower edge is 8 mm above the
    target at most, the blade's middle is within 8 mm of the target along the fissure, and the blade's tilt within 0.1
    rad of the line of sight. What is seen past a blade that opens the fissure from higher up does not count.

    The terms of the dense reward, with $t(d, s) = 1 - \tanh(d / s)$:

    | Name     | Weight | Term                                                                                |
    | -------- | ------ | ----------------------------------------------------------------------------------- |
    | reach    | 0.15   | $t(d, 15\,mm)$, d from the blade's lower edge to 3 mm above, 2 mm beside the target |
    | align    | 0.15   | reach times $t(a, 0.15\,rad)$, a the angle between the blade and the sight          |
    | exposure | 0.2    | share of the target that is seen, as a part of that asked for, 1 at most            |
    | hold     | 0.5    | 1 within tolerance, 0 elsewhere                                                     |
    | force    | -0.1   | magnitude of the contact force [N]                                                  |
    | action   | -0.01  | squared length of the action                                                        |

    ## Starting State
    The organ is at rest. The target's middle is within 10 mm of the fissure's, uniformly; the line of sight is tilted
    by 0.18 to 0.3 rad, uniformly, to either side; the share asked for is uniform in 0.8 to 0.9. The blade is at rest
    within 10 mm of the fissure's middle along x and y, tilted by 0.1 rad at most, its lower edge 4 to 15 mm above the
    organ's top, all uniformly.

    `reset(options={"goal": (place, view, exposure), "tool_position": (x, y, z)})` replaces either of them.

    ## Episode End
    Success is to have been within tolerance for 10 steps (0.5 s) in a row.

    Costs are counted from a loading of 0.8 N/s and a pressure of 2.67 kPa on; safe
    success costs 20 ms at most.

    ## Info
    Besides what every environment tells (see `SpatulaEnv`): `exposure`, the share of the target that is seen;
    `target_distance`, from the blade's lower edge to 3 mm above and 2 mm beside the target, where the sight leans to
    [m]; and `view_error`, the angle between the blade's tilt and the line of sight's [rad].

    ## An Organ of One's Own
    With `organ="FILE.npz"`, a file of `spatula organ prepare --fissure`, the organ stands on the ground, turned about
    the vertical so that its fissure runs along x, and the workspace is over the middle of it. The floor is a parabola
    through the nodes of its line, which are held too. Targets are within 10 mm of the middle, nearer where the blade
    does not get down farther away. Tools are stopped 2 mm above the lowest place of the floor. Observations have one
    more part, `fissure_depth` (1), how high the organ's top is above the target [m]. `max_force` is 0.6 N. Budget and
    limits are those of the preset.

    An organ is refused, with the numbers, if the upright blade meets it on the way down to 3 mm above the target in
    the middle; if more than a tenth of the target is inside it, or more than half is seen at rest; if the floor is
    deeper than the blade reaches, or its lips are higher than the blade; if a wall would have to be moved aside by more
    than 13 mm; or if that wall is nearer to held nodes than one and a half times of what it has to be moved.

    ## Arguments
    Those of `SpatulaEnv`; `task` changes fields of `FissureConfig`. Other defaults have

    | Parameter   | Type               | Default | Description                          |
    | ----------- | ------------------ | ------- | ------------------------------------ |
    | `max_speed` | **float**          | `0.05`  | Greatest speed along each axis [m/s] |
    | `max_force` | **float \| None**  | `0.25`  | With a greater one no tool pushes on |

    ## Version History
    * v0: first version; the task has its second [definition](../definitions.md).
    """

    definition = FISSURE


class FissureVectorEnv(SpatulaVectorEnv):
    """`FissureEnv` in many worlds at once, as `gymnasium.make_vec` makes it; `SpatulaVectorEnv` has the arguments."""

    definition = FISSURE
