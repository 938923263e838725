"""An engine's resources are freed with the object that holds them, whether that was closed or only dropped."""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
from itertools import pairwise

import pytest

from spatula_env import Simulation, scenes
from spatula_env.sim import bullet as bullet_module

pytestmark = pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="memory is read from /proc")

SCRIPT = """
import gc, json, os, sys, tempfile, threading
import gymnasium
import spatula_env
from spatula_env import Simulation, scenes

def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGESIZE")

def use(engine, closed, number):
    # Environments now and then: they take longer.
    if number % 20 == 0:
        held = gymnasium.make("Spatula/Press-v0", engine=engine)
        held.reset(seed=0)
    else:
        held = Simulation(scenes.seed(), engine=engine)
        held.step()
    if closed:
        held.close()

engine = sys.argv[1]
memory = []
for number in range(40):
    # The first twenty are closed, the others dropped.
    use(engine, number < 20, number)
    if number % 5 == 4:
        gc.collect()
        memory.append(resident())
    if number == 9:
        descriptors = len(os.listdir("/proc/self/fd"))
clients = 0
if engine == "bullet":
    import pybullet
    clients = sum(pybullet.isConnected(client) for client in range(200))
files = [name for name in os.listdir(tempfile.gettempdir()) if name.startswith("spatula_env-")]
print(json.dumps({
    "memory": memory,
    "descriptors": len(os.listdir("/proc/self/fd")) - descriptors,
    "clients": clients,
    "threads": threading.active_count() - 1,
    "files": len(files),
}))
"""

FEW = 2**18
"""Greatest growth over five simulations [bytes]; five clients are 150 MB, the lists of five 0.45 MB. As an allocator
occasionally takes memory in larger pieces, only growth in every sample counts as a leak."""


@pytest.mark.parametrize("engine", ["bullet", "batch"])
def test_forty_simulations_leave_nothing_behind(engine, tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, engine],
        env={**os.environ, "TMPDIR": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    memory = found.pop("memory")
    growth = [later - earlier for earlier, later in pairwise(memory)]
    assert min(growth[:3]) < FEW, "closed"
    assert min(growth[3:]) < FEW, "dropped"
    assert found == {"descriptors": 0, "clients": 0, "threads": 0, "files": 0}


@pytest.mark.bullet
def test_a_dropped_simulation_disconnects_its_client():
    import pybullet

    simulation = Simulation(scenes.seed(), engine="bullet")
    client = simulation.worlds.engine.loaded[0]._client
    assert pybullet.isConnected(client)
    del simulation
    gc.collect()
    assert not pybullet.isConnected(client)


@pytest.mark.bullet
def test_a_scene_that_bullet_refuses_leaves_no_client(monkeypatch):
    import pybullet

    before = [pybullet.isConnected(client) for client in range(50)]
    monkeypatch.setattr(bullet_module, "node_masses", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        Simulation(scenes.seed(), engine="bullet")
    gc.collect()
    assert [pybullet.isConnected(client) for client in range(50)] == before


@pytest.mark.parametrize("references", [0, 1, 3])
def test_references_that_a_call_keeps_are_given_back(references):
    rows = [[float(number), 1.0, 2.0] for number in range(5)]
    objects = [rows, *rows]
    before = list(map(sys.getrefcount, objects))
    with bullet_module._given_back(objects):
        # As C code does that forgets what it owns.
        for _ in range(references):
            for each in objects:
                bullet_module.ctypes.pythonapi.Py_IncRef(bullet_module.ctypes.py_object(each))
    assert list(map(sys.getrefcount, objects)) == before
