"""The servo models as data: held against the maker's own list of registers."""

from __future__ import annotations

from importlib import resources

import pytest

from rig.servo_models import MODEL_NAMES, MODELS, control_table

MAKERS = resources.files("dynamixel_easy_sdk") / "control_table"
SPELLED = {
    "secondary(shadow)_id": "secondary_id",
    "present_load": "present_current",
    "protocol_version": "protocol_type",
}


def makers_table(model: str) -> dict[str, tuple[int, int]]:
    """Read the registers of a model as the maker lists them: by name, address and size."""
    text = (MAKERS / f"{model.lower().replace('-', '_')}.model").read_text(encoding="utf-8")
    rows = (line.split("\t") for line in text.split("[control table]")[1].strip().splitlines()[1:])
    named = {row[2].strip().lower().replace(" ", "_"): (int(row[0]), int(row[1])) for row in rows}
    return {
        SPELLED.get(name, name): place
        for name, place in named.items()
        if not name.endswith(("_write", "_read"))
    }


@pytest.mark.parametrize("model", MODELS)
def test_registers_lie_where_the_maker_says(model: str) -> None:
    """Catches a wrong address or width, a register that a model lacks, or one that is left out."""
    ours = {name: (register.address, register.size) for name, register in control_table(model).items()}
    theirs = makers_table(model)
    assert {name: ours.get(name) for name in theirs} == theirs
    newer = {"startup_configuration", "backup_ready"}  # of firmware 45 and later
    assert {n for n in ours if not n.startswith("indirect")} - theirs.keys() <= newer


def test_model_numbers_are_the_makers() -> None:
    """Catches a servo that is taken for another model."""
    rows = (
        line.split() for line in (MAKERS / "dynamixel.model").read_text(encoding="utf-8").splitlines()[1:]
    )
    theirs = {int(number): file.removesuffix(".model") for number, file in rows}
    assert {n: theirs[n] for n in MODEL_NAMES} == {
        number: name.lower().replace("-", "_") for number, name in MODEL_NAMES.items()
    }
