"""Behaviour cloning: a policy that imitates demonstrations, without any reward.

    python -m agents.clone --dataset spatula/press/expert-v0
    python -m agents.clone --env Spatula/Press-v0 --expert 50
    python -m agents.clone --config press_sac --expert 50
    python -m agents.clone --config clamp_sac --expert 64 --rounds 8

What is cloned is the actor of Stable-Baselines3's SAC or PPO. It is saved as training saves policies, so that
`agents.evaluate` and `agents.export` take it. The last line of the output is where it is.

With `--rounds` the policy is corrected: it acts in episodes of its own, the expert says at each step what it would have
done there, and all that has been said so far is imitated (DAgger; S. Ross, G. Gordon and D. Bagnell, "A Reduction of
Imitation Learning and Structured Prediction to No-Regret Online Learning", AISTATS 2011).
"""

from __future__ import annotations

import sys

from spatula_env.learning.commands.clone import main

if __name__ == "__main__":
    sys.exit(main(program="python -m agents.clone"))
