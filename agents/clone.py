"""Behaviour cloning: a policy that imitates demonstrations, without any reward.

    python -m agents.clone --dataset spatula/press/expert-v0
    python -m agents.clone --env Spatula/Press-v0 --expert 50
    python -m agents.clone --config press_sac --expert 50
    python -m agents.clone --config clamp_sac --expert 64 --rounds 8

The actor of Stable-Baselines3's SAC or PPO is cloned. It is saved in the same form as trained policies, so that
`agents.evaluate` and `agents.export` accept it. The last line of the output is its path.

With `--rounds`, the policy is corrected: it acts in episodes of its own, the expert says at each step what it would
have done there, and all of the expert's answers so far are imitated (DAgger; S. Ross, G. Gordon and D. Bagnell, "A
Reduction of Imitation Learning and Structured Prediction to No-Regret Online Learning", AISTATS 2011).
"""

from __future__ import annotations

import sys

from spatula_env.learning.commands.clone import main

if __name__ == "__main__":
    sys.exit(main(program="python -m agents.clone"))
