"""Every entry of `benchmarks/mutations.toml` quotes code that exists exactly once."""

import tomllib
from pathlib import Path

CHECKOUT = Path(__file__).parents[1]


def test_every_place_stands_once_and_its_tests_exist() -> None:
    listed = tomllib.loads((CHECKOUT / "benchmarks" / "mutations.toml").read_text())["mutation"]
    wrong = []
    for each in listed:
        file = CHECKOUT / "trinoc" / each["file"]
        if not file.is_file() or file.read_text().count(each["before"]) != 1:
            wrong.append(f"{each['file']}: {each['what']}: not there once")
        missing = (test for test in each["tests"] if not (CHECKOUT / "tests" / test).exists())
        wrong += [f"no tests/{test}" for test in missing]
    assert not wrong, "\n".join(wrong)
    assert len(listed) >= 60
