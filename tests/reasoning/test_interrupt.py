"""Ctrl-C in a terminal reaches every process there; the worker leaves it to its owner."""

import os
import signal
import time

from reasoning.knowledge import KnowledgeBase


def test_a_worker_that_is_interrupted_goes_on_quietly(capfd) -> None:
    with KnowledgeBase() as knowledge:
        pid = knowledge.engine.pid
        assert pid is not None
        assert knowledge.ask("true").truth == "true"
        os.kill(pid, signal.SIGINT)
        time.sleep(0.05)
        assert knowledge.ask("true").truth == "true"
        assert knowledge.engine.pid == pid
        assert knowledge.engine.restarts == 0
    assert capfd.readouterr().err == ""
