"""Adapters to libraries that have their own environment interface; docs/rl-libraries.md has an example of each.

| Module              | For                                                                              |
| ------------------- | -------------------------------------------------------------------------------- |
| `safety_gymnasium`  | code that expects Safety-Gymnasium's six values from `step`                      |
| `omnisafe`          | OmniSafe's constrained learners                                                  |
| `masa`              | MASA-Safe-RL, which reads labels                                                 |
| `tianshou`          | Tianshou's collectors                                                            |
| `rl_games`          | rl_games                                                                         |
| `lerobot`           | LeRobot's names of observations, and its EnvHub                                  |

Each is imported only on request, and says what to install if its library is missing. `safety_gymnasium`, `masa` and
`lerobot` need no library at all. For Stable-Baselines3 there is `spatula_env.envs.sb3`; libraries that are not listed
use the environments as they are.
"""
