"""Sentences of the library in the words of the command line."""

import dataclasses
import re

# What no option of one command says by its own name.
_PHRASES = {
    "A sigma of `Systematics` is negative": (
        "A standard deviation of --print-scale-sigma or --flatness-mm is negative"
    ),
    "give `rings=` yourself or": "choose a sheet with",
    "; give a sigma_px that is as much smaller to have candidates judged by it too": "",
}


def in_options(sentence: str, command: object) -> str:
    """`parameters=6` as `--parameters 6`, `tolerance_px is` as `--tolerance-px is`.

    Names are those of the command's own options; what stands in quotes or behind a point is of a
    file and stays.
    """
    for phrase, said in _PHRASES.items():
        sentence = sentence.replace(phrase, said)
    for name in _names(command):
        option = f"--{name.replace('_', '-')}"
        given = rf"(?<![\w\".`/-]){re.escape(name)}="
        sentence = re.sub(rf'{given}(?:(?=\w)|"(\w+)")', rf"{option} \1", sentence)
        if "_" in name and '.json: "' not in sentence:
            alone = rf"(?<![\w\".`/-]){re.escape(name)}(?![\w\"=/-]|\.\w)"
            sentence = re.sub(alone, option, sentence)
    return sentence


def _names(command: object) -> list[str]:
    """Names of all options, those of groups of options, too; longest first."""
    found = []
    for field in dataclasses.fields(command):  # pyright: ignore[reportArgumentType]
        value = getattr(command, field.name)
        found += _names(value) if dataclasses.is_dataclass(value) else [field.name]
    return sorted(found, key=len, reverse=True)
