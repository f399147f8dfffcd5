"""Where training's time goes, on tiny settings: what is told, never how fast anything is."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from reproduction.learning.training_loops import (
    EIGHT_LAYERS,
    PARTS,
    VARIANTS,
    Stopwatch,
    Variant,
    our_loop,
    settings_of,
)
from reproduction.program import main as reproduce
from saver_advisors.experiments.grid import read_grid


class Nested:
    """Two methods, one of which calls the other."""

    def outer(self) -> str:
        self.inner()
        return "done"

    def inner(self) -> None:
        until = time.process_time() + 0.02
        while time.process_time() < until:
            pass

    def fail(self) -> None:
        raise ValueError("as asked")


def test_a_stopwatch_counts_nested_time_once() -> None:
    watch, owner = Stopwatch(), Nested()
    watch.watch(owner, "outer", "outer")
    watch.watch(owner, "inner", "inner")
    assert owner.outer() == "done"
    taken = watch.take()
    assert taken["inner"] >= 0.02
    # The whole of it was spent in the inner one.
    assert taken["outer"] < taken["inner"]
    assert watch.take() == {"outer": 0.0, "inner": 0.0}


def test_a_stopwatch_survives_an_error() -> None:
    watch, owner = Stopwatch(), Nested()
    watch.watch(owner, "fail", "fail")
    watch.watch(owner, "inner", "inner")
    with pytest.raises(ValueError, match="as asked"):
        owner.fail()
    owner.inner()
    taken = watch.take()
    assert taken["fail"] < taken["inner"]


def test_a_variant_changes_what_it_says_and_nothing_else() -> None:
    config = settings_of("DualJacoPush-v0", VARIANTS[0])
    usual = config.to_mapping()
    for variant in VARIANTS:
        changed = settings_of("DualJacoPush-v0", variant).to_mapping()
        differing = {name for name in usual if usual[name] != changed[name]}
        assert differing == set(variant.settings(config))
        assert differing or variant.prepare or variant is VARIANTS[0]


@pytest.mark.parametrize("variant", VARIANTS, ids=[variant.name for variant in VARIANTS])
def test_every_variant_can_be_built_with_and_without_advice(variant: Variant) -> None:
    assert not hasattr(our_loop("DualJacoPush-v0", variant, by_part=False).model, "advisor")
    loop = our_loop("DualJacoDistance-v0", variant, by_part=False)
    assert loop.model.advisor.strategy.name == "early"


def test_the_papers_layers_are_those_of_the_row_that_was_trained() -> None:
    grid = read_grid(Path(__file__).resolve().parents[2] / "zoo_configs" / "constraints.yml")
    [run] = grid.only(["distance-min-eight-layers-seed0"]).runs
    assert run.config.net_arch == EIGHT_LAYERS


def test_the_parts_of_a_block_add_up() -> None:
    loop = our_loop("DualJacoDistance-v0", VARIANTS[0], by_part=True)
    block = loop.block()
    assert block.keys() == {*(part for _, _, part in PARTS), "the rest", "total"}
    assert min(block.values()) > 0
    assert sum(block.values()) == pytest.approx(2 * block["total"])
    assert loop.model.num_timesteps == loop.steps
    assert loop.model._n_updates == loop.updates


def test_the_whole_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    figures, page = tmp_path / "learning.json", tmp_path / "learning.md"
    words = "learning --envs JacoPush-v0 --variants bfloat16 --stock TD3 --rounds 1"
    files = ["--json", str(figures), "--table", str(page)]
    assert reproduce([*words.split(), *files]) == 0
    row = json.loads(figures.read_text())["rows"][0]
    assert [one["name"] for one in row["variants"]] == [
        "as configured",
        "bfloat16",
        "SB3's TD3 + HER",
    ]
    assert row["variants"][0]["times_as_fast"] == 1.0
    assert sum(row["parts"].values()) == pytest.approx(row["total"])
    # The page is a rendering of the file and of nothing else.
    capsys.readouterr()
    assert reproduce(["learning", "--from", str(figures)]) == 0
    assert capsys.readouterr().out.strip() == page.read_text().strip()
    # A page without a name is called as the command is.
    monkeypatch.chdir(tmp_path)
    page.rename("first.md")
    assert reproduce(["learning", "--from", str(figures), "--table"]) == 0
    assert page.read_text() == Path("first.md").read_text()


def test_an_unknown_variant_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        reproduce(["learning", "--variants", "float8"])
    assert "float8" in capsys.readouterr().err
