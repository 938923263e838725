"""The environments for libraries that have an interface of their own; docs/rl-libraries.md has an example of each.

| Module              | For                                                                              |
| ------------------- | -------------------------------------------------------------------------------- |
| `safety_gymnasium`  | what expects Safety-Gymnasium's six values from `step`                           |
| `omnisafe`          | OmniSafe's constrained learners                                                  |
| `masa`              | MASA-Safe-RL, which reads labels                                                 |
| `tianshou`          | Tianshou's collectors                                                            |
| `rl_games`          | rl_games                                                                         |
| `lerobot`           | LeRobot's names of observations, and its EnvHub                                  |

None is imported before it is asked for, and each says what to install where its library is missing. Of the libraries,
`safety_gymnasium`, `masa` and `lerobot` import none at all. Stable-Baselines3 has `spatula_env.envs.sb3`; what is not
listed takes the environments as they are.
"""
