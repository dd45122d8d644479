"""Commands run in this process, without the user's compile cache and without a trace."""

import logging

import pytest

from trinoc.io.compile_cache import COMPILE_CACHE_VARIABLE


@pytest.fixture(autouse=True)
def _no_traces(monkeypatch):
    monkeypatch.setenv(COMPILE_CACHE_VARIABLE, "off")
    logger = logging.getLogger("trinoc")
    before = logger.handlers[:], logger.level, logger.propagate
    yield
    logger.handlers[:], logger.level, logger.propagate = before
