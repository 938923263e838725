"""Spatula/Clamp-v0, for one agent and for many."""

from __future__ import annotations

from spatula_env import scenes
from spatula_env.envs.control import ControlLayout
from spatula_env.envs.levels import HARD_RANGES, Level, hard_level, standard_level
from spatula_env.envs.observed_ranges import ObservedRanges
from spatula_env.envs.randomization import DEFAULT_RANGES
from spatula_env.envs.settings import Definition, OwnOrgan
from spatula_env.envs.spatula_env import SpatulaEnv
from spatula_env.envs.vector import SpatulaVectorEnv
from spatula_env.scenes.material import LENIENT_STRAIN
from spatula_env.tasks.clamp import ClampConfig, ClampTask
from spatula_env.tasks.clamp_anywhere import ClampAnywhereTask

OPENING_RANGE = (0.002, 0.032)
"""Least and greatest free width between the jaws [m]. A clamp for tissue does not close altogether: what is between its
jaws has to stay somewhere."""

CLAMP = Definition(
    name="clamp",
    scene=scenes.clamp,
    task=ClampTask,
    config=ClampConfig,
    # The cube reaches 76 mm above the organ's top and 26 mm below it.
    workspace_height=0.025,
    # Half as high as the ridge's foot.
    stop_height=0.012,
    controls={
        "velocity": ControlLayout(jaws=True, opening_range=OPENING_RANGE),
        "velocity_6d": ControlLayout(rotations="xyz", max_turn=0.6, jaws=True, opening_range=OPENING_RANGE),
    },
    defaults={"max_speed": 0.05},
    # More than experts, haste and random motion have met, but for pressures and for an organ that has been pushed away.
    # Jaws that hang upright are touched from above by nothing.
    observed=ObservedRanges(
        force=1.5,
        torque=0.01,
        contact_depth=0.012,
        mean_pressure=6e3,
        displacement=0.06,
        untouched={"velocity": (5, 11)},
        face_count=12,
    ),
    own_organ=OwnOrgan(scenes.organ_with_ridge, ClampAnywhereTask),
    # With less friction, no grip that is allowed holds.
    randomization={**DEFAULT_RANGES, "friction": (0.8, 1.5)},
    levels={
        "easy": Level(),
        "standard": standard_level(),
        # Jaws that close on a ridge twice as stiff as usual press too hard on it, however they are regulated.
        "hard": hard_level(
            {**HARD_RANGES, "friction": (0.8, 1.8), "stiffness": (0.5, 1.6)},
            task={"start_offset": 0.014, "start_height_range": (0.002, 0.025)},
            strain_limit=LENIENT_STRAIN,
        ),
    },
)
"""Two jaws above a ridge."""


class ClampEnv(SpatulaEnv):
    r"""Grip a ridge between two jaws, lift it to a height, and hold it there without letting it slip.

    ## Description
    Two jaws, 24 x 16 x 2.4 mm each, hang open above a ridge 40 mm long, 16 mm wide and 26 mm high on a soft organ that
    lies on the ground. The agent moves the clamp and opens and closes it. It has to grip the ridge, to lift it by a
    given height (4 to 12 mm), and to keep it there for half a second, without letting it slip through the jaws by more
    than 1 to 2 mm.

    The organ is not fixed: it hangs from the ridge, by friction alone (coefficient 0.4). Jaws that take away less than
    about a sixth of the ridge's width let it slip; jaws that take away a quarter hold it; more only presses harder.

    `SpatulaEnv` tells what all environments have in common.

    ## Action Space
    The action space is a `Box(-1, 1, (4,), float32)`: velocities of the grip, the middle between the jaws, as fractions
    of `max_speed`, and the speed at which the jaws part, as a fraction of `max_jaw_speed`. The jaws are stopped at free
    widths of 2 and 32 mm. The clamp does not turn (with `control="velocity_6d"` it does).

    | Num | Action                                    | Min | Max | Name       | Falcon | Unit                       |
    | --- | ----------------------------------------- | --- | --- | ---------- | ------ | -------------------------- |
    | 0   | velocity to the operator's right          | -1  | 1   | velocity_x | x      | `max_speed` (0.05 m/s)     |
    | 1   | velocity away from the operator           | -1  | 1   | velocity_y | -z     | `max_speed` (0.05 m/s)     |
    | 2   | velocity upwards                          | -1  | 1   | velocity_z | y      | `max_speed` (0.05 m/s)     |
    | 3   | speed at which the jaws part from another | -1  | 1   | jaw_speed  |        | `max_jaw_speed` (0.05 m/s) |

    The ridge runs along x, to the operator's right; the jaws close along y, the first from the operator's side. With
    `control="velocity_6d"` there are seven numbers: three rates of rotation about x, y and z, as `rotation_x`,
    `rotation_y` and `rotation_z`, before the speed of the jaws; and the observation tells orientation and its rate,
    three numbers each, after the velocity.

    The workspace's middle is 25 mm above the ridge's top at rest.

    ## Observation Space
    The observation is a `Box((86,), float32)` of these parts:

    | Num   | Observation                                                 | Min     | Max    | Name             | Unit |
    | ----- | ----------------------------------------------------------- | ------- | ------ | ---------------- | ---- |
    | 0-2   | position of the grip, the middle between the jaws (x, y, z) | -0.0508 | 0.0508 | tool_position    | m    |
    | 3-5   | velocity of the grip in the last step                       | -0.05   | 0.05   | tool_velocity    | m/s  |
    | 6     | free width between the jaws                                 | 0.002   | 0.032  | jaw_opening      | m    |
    | 7     | speed at which they parted in the last step                 | -0.05   | 0.05   | jaw_speed        | m/s  |
    | 8-10  | mean force on the first jaw in the last step                | -1.5    | 1.5    | contact_force    | N    |
    | 11-13 | the same on the second jaw                                  | -1.5    | 1.5    | contact_force    | N    |
    | 14-16 | mean torque on both about the grip                          | -0.01   | 0.01   | contact_torque   | N m  |
    | 17    | share of the first jaw's nodes in contact: inner face       | 0       | 1      | contact_share    | 1    |
    | 18    | of its outer face                                           | 0       | 1      | contact_share    | 1    |
    | 19-21 | of its rims: left, right, lower                             | 0       | 1      | contact_share    | 1    |
    | 22    | of the second jaw's outer face                              | 0       | 1      | contact_share    | 1    |
    | 23    | of its inner face                                           | 0       | 1      | contact_share    | 1    |
    | 24-26 | of its rims: left, right, lower                             | 0       | 1      | contact_share    | 1    |
    | 27    | deepest contact, before the organ gives way                 | 0       | 0.012  | contact_depth    | m    |
    | 28    | greatest pressure in the last step                          | 0       | 20000  | contact_pressure | Pa   |
    | 29    | mean pressure on the face that is pressed most              | 0       | 6000   | contact_pressure | Pa   |
    | 30-77 | displacement of 16 nodes of the organ (x, y, z)             | -0.06   | 0.06   | landmarks        | m    |
    | 78-80 | from the grip to the middle of the ridge's flanks           | -0.12   | 0.12   | ridge_offset     | m    |
    | 81    | lift asked for                                              | -0.03   | 0.08   | goal             | m    |
    | 82    | slip allowed                                                | 0       | 0.02   | goal             | m    |
    | 83    | lift asked for minus lift                                   | -0.11   | 0.11   | error            | m    |
    | 84    | slip allowed minus slip                                     | -0.02   | 0.02   | error            | m    |
    | 85    | for how long the goal has been held, of what is asked       | 0       | 1      | hold_progress    | 1    |

    With `control="velocity_6d"` there are numbers for the jaws' upper rims too, which nothing touches else.

    Sensors know `tool_position`, `tool_velocity`, `jaw_opening`, `jaw_speed`, `contact_force`, `contact_torque` and
    `goal`; all else is privileged.

    With `reward="sparse"` goals are (lift, slip).

    ## Rewards
    The *lift* is by how much higher the nodes of the ridge's crest are than at rest, on average. A *grip* begins when
    both jaws touch the organ with the faces that they turn to each other, and ends when neither does. Its *slip* is how
    far the part of the ridge that was between the jaws when the grip began has moved along their faces since; while not
    both jaws touch, it counts as 20 mm. A step is *within tolerance* if the lift is within 1 mm of the goal's and the
    slip is no greater than the goal's, while either jaw presses on the ridge with 80 to 250 mN; with less or more the
    slip counts as 20 mm, so that neither a loose grip holds nor one that crushes.

    The terms of the dense reward, with $t(d, s) = 1 - \tanh(d / s)$:

    | Name   | Weight | Term                                                            |
    | ------ | ------ | --------------------------------------------------------------- |
    | reach  | 0.15   | $t(d, 15\,mm)$, d from the grip to the middle of the ridge      |
    | grip   | 0.1    | 1 while both jaws touch, 0 else                                 |
    | lift   | 0.25   | grip times $t(d, 5\,mm)$, d the error of the lift                |
    | hold   | 0.5    | 1 within tolerance, 0 elsewhere                                 |
    | slip   | -10.0  | grip times slip [m]                                             |
    | force  | -0.1   | sum of the magnitudes of the two jaws' contact forces [N]       |
    | action | -0.01  | squared length of the action                                    |

    ## Starting State
    The organ is at rest. The lift is uniform in 4 to 12 mm, the slip allowed uniform in 1 to 2 mm. The clamp is at
    rest, its middle within 8 mm of the ridge's along x and y, the jaws' lower edges 2 to 12 mm above the crest, the
    free width between them 20 to 30 mm, all uniformly.

    `reset(options={"goal": (lift, slip), "tool_position": (x, y, z)})` replaces either of them [m].

    `randomization="default"` and the levels draw friction from 0.8 on: no grip that is allowed holds a smoother ridge.

    ## Episode End
    Success is to have been within tolerance for 10 steps (0.5 s) in a row.

    Costs are counted from a loading of 1.2 N/s and a pressure of 2.67 kPa on; safe
    success costs 20 ms at most.

    ## Info
    Besides what every environment tells (see `SpatulaEnv`): `lift`, `lift_error` and `slip` [m]; `gripped`, 1 with a
    grip and 0 without; and `grip_force`, that of the jaw that presses less [N].

    ## An Organ of One's Own
    With `organ="FILE.npz"`, a file of `spatula organ prepare --ridge`, the organ stands on the ground, turned about the
    vertical so that its ridge runs along x, and the workspace is over the middle of it. The ridge is what is between
    the jaws there, which get 18 mm below its crest, or less deep where they do not fit, down to 8 mm. The crest is what
    is at most 3 mm below the lowest point of its top between the jaws. The jaws start above all of the organ.
    Observations have one more part, `ridge_shape` (3): the ridge's width, and the heights above the middle of its
    flanks where the jaws grip and where they are free of the organ [m]. Budget and limits are those of the preset.

    An organ is refused, with the numbers, if the ridge is shorter than half a jaw, narrower than 6 mm, or wider than
    the jaws are open at the start, less 2 mm; if its flanks lean by more than a tenth of their height; if jaws do not
    get beside it; or if nodes are held that are nearer to the jaws than ten times the greatest lift. So most organs
    have to lie free, as the preset's does.

    ## Arguments
    Those of `SpatulaEnv`; `task` changes fields of `ClampConfig`. Another default has

    | Parameter   | Type      | Default | Description                          |
    | ----------- | --------- | ------- | ------------------------------------ |
    | `max_speed` | **float** | `0.05`  | Greatest speed along each axis [m/s] |

    ## Version History
    * v0: first version; the task has its second [definition](../definitions.md).
    """

    definition = CLAMP


class ClampVectorEnv(SpatulaVectorEnv):
    """`ClampEnv` in many worlds at once, as `gymnasium.make_vec` makes it; `SpatulaVectorEnv` has the arguments."""

    definition = CLAMP
