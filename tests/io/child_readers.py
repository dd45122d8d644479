"""Readers for the tests of child processes: one that answers, and ones that fail in every way."""

import os
import time


def count(content):
    return {"bytes": len(content), "numbers": [0.1, float("nan")]}


def crash(content):
    os.abort()


def leave(content):
    os._exit(0)


def wait(content):
    time.sleep(60)


def fail(content):
    raise ValueError("two\nlines")


def fill(content):
    return len(bytes(64 << 30))
