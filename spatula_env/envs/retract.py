"""Spatula/Retract-v0, for one agent and for many."""

from __future__ import annotations

from spatula_env import scenes
from spatula_env.envs.levels import Level, hard_level, standard_level
from spatula_env.envs.observed_ranges import ObservedRanges
from spatula_env.envs.settings import Definition, OwnOrgan
from spatula_env.envs.spatula_env import SpatulaEnv
from spatula_env.envs.vector import SpatulaVectorEnv
from spatula_env.tasks.retract import RetractConfig, RetractTask
from spatula_env.tasks.retract_anywhere import RetractAnywhereTask

RETRACT = Definition(
    name="retract",
    scene=scenes.retract,
    task=RetractTask,
    config=RetractConfig,
    # The blade's middle reaches 71 mm above the organ's top and 31 mm below it, its lower edge 20 mm farther down.
    workspace_height=0.02,
    # Two millimetres below the fold's foot.
    stop_height=0.014,
    # A fold is held aside with 0.2 N at most.
    defaults={"max_speed": 0.05, "max_force": 0.5},
    # More than experts, haste and random motion have met, but for the greatest pressure. The fold does not reach the
    # blade's upper edge.
    observed=ObservedRanges(
        force=0.8,
        torque=0.012,
        contact_depth=0.03,
        mean_pressure=4e3,
        displacement=0.04,
        untouched={"velocity": (5,)},
        face_count=6,
    ),
    levels={
        "easy": Level(),
        "standard": standard_level(),
        "hard": hard_level(
            task={"place_limit": 0.01, "start_offset": (0.028, 0.015), "start_height_range": (0.006, 0.035)}
        ),
    },
    own_organ=OwnOrgan(scenes.organ_from_aside, RetractAnywhereTask, {"max_force": 1.0}),
)
"""A blade over a fold."""


class RetractEnv(SpatulaEnv):
    r"""Move a marked patch of the organ's surface aside, and hold it there.

    ## Description
    An upright steel blade, 20 mm wide, 40 mm high and 1.8 mm thick, hovers over a soft fold, 48 mm long, 18 mm wide
    and 28 mm high, on a piece of an organ that is held at its base and as stiff as brain tissue. The fold runs away
    from the operator, and the blade's faces look to the left and to the right. A patch is marked on one of the fold's
    flanks. The agent moves the blade. It has to go to the patch's side of the fold, down beside it, and to push, until
    the patch is displaced by a given vector (4 to 10 mm, across the fold or turned away from that by 7 degrees at
    most), and to keep it there for half a second, as a surgeon does who holds tissue aside to see what is behind it.

    The displacement is measured on the organ. The fold leans and is dented, so the patch does not move as the blade
    does; and the blade moves it along the fold only by friction, and slips if it is drawn along too far. It takes
    0.06 to 0.2 N.

    `SpatulaEnv` tells what all environments have in common.

    ## Action Space
    The action space is a `Box(-1, 1, (3,), float32)`: the blade's velocity as a fraction of `max_speed`. It does not
    turn; with `control="velocity_6d"`, which has six numbers, it does.

    | Num | Action                           | Min | Max | Name       | Falcon | Unit                   |
    | --- | -------------------------------- | --- | --- | ---------- | ------ | ---------------------- |
    | 0   | velocity to the operator's right | -1  | 1   | velocity_x | x      | `max_speed` (0.05 m/s) |
    | 1   | velocity away from the operator  | -1  | 1   | velocity_y | -z     | `max_speed` (0.05 m/s) |
    | 2   | velocity upwards                 | -1  | 1   | velocity_z | y      | `max_speed` (0.05 m/s) |

    The workspace's middle is 20 mm above the organ's top at rest.

    ## Observation Space
    The observation is a `Box((79,), float32)` of these parts:

    | Num   | Observation                                           | Min     | Max    | Name             | Unit |
    | ----- | ----------------------------------------------------- | ------- | ------ | ---------------- | ---- |
    | 0-2   | position of the blade's middle (x, y, z)              | -0.0508 | 0.0508 | tool_position    | m    |
    | 3-5   | velocity of the blade in the last step                | -0.05   | 0.05   | tool_velocity    | m/s  |
    | 6-8   | mean force on the blade in the last step              | -0.8    | 0.8    | contact_force    | N    |
    | 9-11  | its mean torque about the blade's middle              | -0.012  | 0.012  | contact_torque   | N m  |
    | 12-13 | share of the nodes in contact: left face, right face  | 0       | 1      | contact_share    | 1    |
    | 14-15 | the same of the edges: near, far                      | 0       | 1      | contact_share    | 1    |
    | 16    | the same of the lower edge                            | 0       | 1      | contact_share    | 1    |
    | 17    | deepest contact, before the organ gives way           | 0       | 0.03   | contact_depth    | m    |
    | 18    | greatest contact pressure on a node in the last step  | 0       | 20000  | contact_pressure | Pa   |
    | 19    | greatest mean pressure on a face                      | 0       | 4000   | contact_pressure | Pa   |
    | 20-67 | displacement of 16 nodes of the organ (x, y, z)       | -0.04   | 0.04   | landmarks        | m    |
    | 68-70 | position of the patch's middle (x, y, z)              | -0.06   | 0.06   | patch_position   | m    |
    | 71-73 | displacement of the patch (x, y, z)                   | -0.03   | 0.03   | patch_shift      | m    |
    | 74-75 | displacement asked for (x, y)                         | -0.03   | 0.03   | goal             | m    |
    | 76-77 | displacement asked for minus displacement             | -0.06   | 0.06   | error            | m    |
    | 78    | for how long the goal has been held, of what is asked | 0       | 1      | hold_progress    | 1    |

    The patch is what is within 9 mm of its middle on the flank; its position and its displacement are weighted means of
    its nodes', and nodes nearer its middle count for more. With `control="velocity_6d"` there is a number for the upper
    edge too, which the fold does not reach else.

    Sensors know `tool_position`, `tool_velocity`, `contact_force`, `contact_torque` and `goal`; all else is privileged.
    The goal's sign tells on which flank the patch is; where on it, a picture shows.

    With `reward="sparse"` goals are displacements (x, y).

    ## Rewards
    A step is *within tolerance* if the patch's displacement is within 1 mm of the goal, horizontally, while
    the blade pushes against the patch's flank with 10 mN at least and with twice of what it presses down with, its
    lower edge 2 mm or more below the patch's middle. Without, the displacement counts as zero: a fold that is dragged
    along by its crest is not retracted.

    The terms of the dense reward, with $t(d, s) = 1 - \tanh(d / s)$:

    | Name   | Weight | Term                                                                                |
    | ------ | ------ | ----------------------------------------------------------------------------------- |
    | reach  | 0.25   | $t(d, 20\,mm)$, d from the blade to where it touches the patch, its edge 8 mm below |
    | shift  | 0.25   | $t(d, 3\,mm)$, d from the patch's displacement to the goal                          |
    | hold   | 0.5    | 1 within tolerance, 0 elsewhere                                                     |
    | force  | -0.02  | magnitude of the contact force [N]                                                  |
    | action | -0.01  | squared length of the action                                                        |

    ## Starting State
    The organ is at rest. The patch is on the left or on the right flank with equal chance, its middle within 8 mm of
    the fold's middle along the fold, and in the lower half of what is between the flank's lowest nodes and the crest.
    The displacement is uniform in 4 to 10 mm and within 0.12 rad of across the fold. The blade is at rest within 20 mm
    of the fold's middle across the fold and 10 mm along it, its lower edge uniform in 6 to 20 mm above the organ's top.

    `reset(options={"goal": (x, y), "tool_position": (x, y, z)})` replaces either of them [m]; the patch is on that
    flank from which the goal leads into the fold.

    ## Episode End
    Success is to have been within tolerance for 10 steps (0.5 s) in a row.

    Costs are counted from a loading of 0.4 N/s and a pressure of 2.67 kPa on; safe
    success costs 20 ms at most.

    ## Info
    Besides what every environment tells (see `SpatulaEnv`):

    | Key           | Meaning                                              | Unit |
    | ------------- | ---------------------------------------------------- | ---- |
    | `shift`       | how far the patch is from where it was, horizontally | m    |
    | `shift_error` | distance of its displacement from the goal           | m    |
    | `pushing`     | whether the blade pushes against its flank, 0 or 1   | 1    |

    ## An Organ of One's Own
    With `organ="FILE.npz"`, a file of `spatula organ prepare`, the organ stands on the ground and the workspace is over
    that part of it of which most can be pushed from the side. Patches are drawn from all walls, steeper than 66
    degrees, beside which there is room for the blade to come straight down until its lower edge is 8 mm below the
    patch's middle. The blade is turned to the wall and pushes along the horizontal part of its normal, by 4 to 6 mm.
    Observations have two more parts, `patch_outwards` (2), that direction away from the organ, and `patch_room` (1), at
    what distance from the wall there is room [m]. `max_force` is 1 N. Budget and limits are those of the fold.

    ## Arguments
    Those of `SpatulaEnv`; `task` changes fields of `RetractConfig`. Other defaults have

    | Parameter   | Type               | Default | Description                          |
    | ----------- | ------------------ | ------- | ------------------------------------ |
    | `max_speed` | **float**          | `0.05`  | Greatest speed along each axis [m/s] |
    | `max_force` | **float \| None**  | `0.5`   | With a greater one no tool pushes on |

    ## Version History
    * v0: first version; the task has its second [definition](../definitions.md).
    """

    definition = RETRACT


class RetractVectorEnv(SpatulaVectorEnv):
    """`RetractEnv` in many worlds at once, as `gymnasium.make_vec` makes it; `SpatulaVectorEnv` has the arguments."""

    definition = RETRACT
