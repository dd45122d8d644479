"""A fork after JAX has computed is reported in one sentence; a fork before works."""

import os
import subprocess
import sys
import textwrap

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs os.fork")
# A child that hangs is ended by its own alarm.
SCRIPT = """
import os, signal, sys
import trinoc
from trinoc.synth import table1_rig

def call_in_child(call):
    pid = os.fork()
    if pid == 0:
        signal.alarm(30)
        try:
            call()
        except trinoc.errors.TrinocError as error:
            print(error, flush=True)
            os._exit(7)
        os._exit(0)
    print("exit", os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)

rig = table1_rig()
rig.matrices_px
project = lambda: rig["left"].project((0.0, 0.0, 0.0))
call_in_child(project)
before = project()
call_in_child(project)
call_in_child(lambda: trinoc.match_segments({"left": [], "right": []}, rig))
assert (project() == before).all()
"""


def test_a_child_of_a_process_that_used_jax_says_so() -> None:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", textwrap.dedent(SCRIPT)],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    lines = done.stdout.splitlines()
    assert [line for line in lines if line.startswith("exit")] == ["exit 0", "exit 7", "exit 7"]
    sentences = [line for line in lines if not line.startswith("exit")]
    assert len(sentences) == 2
    for sentence in sentences:
        assert "spawn" in sentence
        assert "forkserver" in sentence
