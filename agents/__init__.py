"""The scripts that train, clone, export and evaluate policies: `python -m agents.NAME` in a checkout.

What they call is `spatula_env.learning`, which is installed; `cleanrl_ppo` and `cleanrl_sac` are whole algorithms in a
file each.
"""
