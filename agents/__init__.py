"""Scripts that train, clone, export and evaluate policies: `python -m agents.NAME` in a checkout.

They call `spatula_env.learning`, which is installed with the package; `cleanrl_ppo` and `cleanrl_sac` are complete
algorithms in one file each.
"""
