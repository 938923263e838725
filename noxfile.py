"""The package with one interpreter after the other: `make test-matrix`.

For each that is there: a fresh environment, the package installed by pip alone with no compiler to be had, an episode
of Press by `gym.make` and `gym.make_vec`, then the tests that need neither torch nor a browser. ARGS go to pytest.
"""

from __future__ import annotations

import time
from pathlib import Path

import nox

INTERPRETERS = ("3.10", "3.11", "3.12", "3.13", "3.14")

NO_COMPILER = {"CC": "/bin/false", "CXX": "/bin/false"}

EPISODE = """
import platform
import gymnasium as gym
import spatula_env, spatula_env.engines as engines

with gym.make("Spatula/Press-v0") as env:
    env.reset(seed=0)
    for _ in range(5):
        observation, reward, *_ = env.step(env.action_space.sample())
    engine = env.unwrapped.settings.engine
envs = gym.make_vec("Spatula/Press-v0", num_envs=4)
envs.reset(seed=0)
for _ in range(5):
    _, rewards, *_ = envs.step(envs.action_space.sample())
envs.close()
bullet = " ".join(engines.bullet_version() or ("no PyBullet",))
print(f"Python {platform.python_version()}, {bullet}: Press made and stepped by make ({engine}) and make_vec")
"""

nox.options.sessions = ["core"]


@nox.session(python=INTERPRETERS, venv_backend="venv")
def core(session: nox.Session) -> None:
    """Install without a compiler, make and step Press, run the core of the tests."""
    start = time.monotonic()
    session.install(".", env=NO_COMPILER)
    session.log(f"pip install . took {time.monotonic() - start:.0f} s")
    # Outside of the repository: what is installed is what is imported.
    script = Path(session.create_tmp()) / "episode.py"
    script.write_text(EPISODE, encoding="utf-8")
    with session.chdir(script.parent):
        session.run("python", script.name)
    session.install("--constraint", "requirements/lock.txt", ".[test]", env=NO_COMPILER)
    results = f"--junitxml=build/test-results/python-{session.python}.xml"
    session.run("python", "-m", "pytest", "-q", "-rs", results, *session.posargs)
