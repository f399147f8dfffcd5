"""Table 5.2's counterpart: what is read, summed up, judged and rendered."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import pytest
from run_files import EVERY, curve, write_run

from reproduction.advising.advising_command import (
    evaluate_findings,
    figures,
    strategies,
    tables,
)
from reproduction.advising.paper import PaperFigures, table_5_2
from reproduction.findings import (
    ABBREVIATIONS,
    Finding,
    Measured,
    Metric,
    Table,
    claims,
    evaluate_claim,
    table_of,
)
from reproduction.program import main as reproduce
from saver_advisors.cli.measured import read_training
from saver_advisors.experiments.plots import Panel, draw_panels, mean_curve
from saver_advisors.experiments.summary import summarize
from saver_advisors.experiments.training_runs import read_training_runs
from saver_advisors.reporting.errors import UsageError

PUSH, PICK = "DualJacoPush-v0", "DualJacoPickAndPlace-v0"


def paper_as_table(figures: Mapping[str, PaperFigures], copies: int = 1, shift: float = 0) -> Table:
    """The paper's own rows, as if each had been run ``copies`` times with the same outcome."""

    def look_up(metric: Metric, name: str) -> Measured | None:
        if name not in figures:
            return None
        one = figures[name]
        value = one[ABBREVIATIONS[metric]]
        if one["MSR"] == 0:
            # Never learned: no epochs, and a rate of 0.
            value = 0.0 if metric in ("maximum_success_rate", "effective_learning_rate") else None
        return Measured([] if value is None else [value] * copies, shift)

    return look_up


def judged(text: str, table: Table, task: str = "push") -> Finding:
    """The finding whose claim has that text."""
    [claim] = [
        claim for claim in claims(table_5_2().rows) if text in claim.text and claim.task == task
    ]
    return evaluate_claim(claim, table)


def test_the_papers_table_obeys_its_own_definition() -> None:
    for task in table_5_2().figures.values():
        for one in task.values():
            if one["ELR"] is None or one["IE"] is None:
                continue
            rate = 0.9 * one["MSR"] / (one["IE"] + one["RT"])
            assert rate == pytest.approx(one["ELR"], abs=1e-4)


@pytest.mark.parametrize(("copies", "beyond"), [(1, "too few seeds"), (4, "yes")])
def test_the_papers_findings_hold_in_its_own_table(copies: int, beyond: str) -> None:
    paper = table_5_2()
    for claim in claims(paper.rows):
        found = evaluate_claim(claim, paper_as_table(paper.figures[claim.task], copies))
        assert found.verdict == "holds", claim
        assert found.beyond_seeds == beyond
        assert found.n == copies
        assert not found.missing


def test_findings_that_do_not_hold() -> None:
    worst = {"IE": 900.0, "RT": 500.0, "MSR": 0.5, "ELR": 0.0001}
    push = {**table_5_2().figures["push"], "mc-q 0.1": worst, "mc-actabs 0.01": worst}
    table = paper_as_table(push, copies=4)
    assert judged("MC-ACTABS 0.01", table).verdict == "does not hold"
    assert judged("MC-ACTABS 0.01", table).beyond_seeds == "yes"
    assert judged("looser", table).verdict == "does not hold"
    assert judged("MC-Q is first", table).verdict == "holds"  # by another threshold of it
    none = {"IE": 1.0, "RT": 1.0, "MSR": 0.9, "ELR": 0.0030}
    advice = judged("all advice", paper_as_table({**push, "none": none}))
    assert advice.verdict == "does not hold"
    assert "mc-q 0.1: 0.0001, of none: 0.0030" in advice.text()


def test_what_evaluations_cannot_tell_apart_is_not_told() -> None:
    push = table_5_2().figures["push"]
    # MC-ACTABS 0.01 leads by 0.0042: finer than 0.004 each can tell.
    assert judged("MC-ACTABS 0.01", paper_as_table(push, shift=0.002)).verdict == "holds"
    close = judged("MC-ACTABS 0.01", paper_as_table(push, shift=0.004))
    assert close.verdict == "cannot be told"
    assert close.beyond_seeds == "-"


def test_missing_rows_can_refute_but_not_confirm() -> None:
    push = dict(table_5_2().figures["push"])
    del push["mc-act 0.05"]
    found = judged("MC-ACTABS 0.01", paper_as_table(push))
    assert (found.verdict, found.n, found.missing) == ("holds so far", 1, ["mc-act 0.05"])
    assert found.beyond_seeds == "-"
    del push["mc-actabs 0.01"]
    nothing = judged("MC-ACTABS 0.01", paper_as_table(push))
    assert (nothing.verdict, nothing.n) == ("cannot be told", 0)
    push["mc-actabs 0.01"] = table_5_2().figures["push"]["mc-actabs 0.01"]
    push["early"] = {"IE": 1.0, "RT": 1.0, "MSR": 0.99, "ELR": 0.9}
    assert judged("MC-ACTABS 0.01", paper_as_table(push)).verdict == "does not hold"
    # The best MC-Q is beaten; but one of them is missing, and might not be.
    assert judged("MC-Q is first", paper_as_table(push)).verdict == "does not hold"
    del push["mc-q 0.05"]
    assert judged("MC-Q is first", paper_as_table(push)).verdict == "cannot be told"


def test_rows_that_hardly_learned_do_not_rise_fast(tmp_path: Path) -> None:
    write_run(tmp_path, PUSH, "none", 0, curve(1, best=0.04, width=0.1))
    write_run(tmp_path, PUSH, "mc-act 0.01", 0, curve(20, width=1))
    rows = summarize(PUSH, read_training_runs([tmp_path]).of_task(PUSH))
    look_up = table_of(rows)
    assert rows[1].name == "none"
    assert rows[1].rise_time is not None  # by its definition: of its own maximum of 0.04
    hardly = look_up("rise_time", "none")
    assert hardly is not None
    assert not hardly.values
    assert look_up("rise_time", "early") is None


def test_a_row_sums_up_its_seeds_by_hand(tmp_path: Path) -> None:
    for seed, first in enumerate((4, 6)):
        write_run(tmp_path, PUSH, "early", seed, curve(first, width=0.01))
    [row] = summarize(PUSH, read_training_runs([tmp_path]).of_task(PUSH))
    assert row.n == 2
    assert row.steps_to_solved is not None
    # Up at once, from half at the middle: 0.9 is first seen one evaluation later.
    assert row.steps_to_solved.estimate.value == 6 * EVERY
    assert row.steps_to_solved.estimate.interval == (5 * EVERY, 7 * EVERY)
    assert row.all_steps_to_solved is not None
    assert row.all_steps_to_solved.estimate.value == 6 * EVERY + 600_000
    assert row.seconds_to_solved is not None
    assert row.seconds_to_solved.text(1, 1 / 60) == "6.0 [5.0, 7.0]"
    assert row.advice_spent is not None
    assert row.advice_spent.value == 100_000
    assert row.advice_over is not None
    assert row.advice_over.value == 4 * EVERY
    assert row.unsolved_seeds == []
    assert row.collisions is not None
    assert row.collisions.value == 2.5


def test_censored_seeds_make_a_bound(tmp_path: Path) -> None:
    write_run(tmp_path, PUSH, "none", 0, curve(20, best=0.6))
    write_run(tmp_path, PUSH, "none", 1, curve(4, width=0.01))
    [row] = summarize(PUSH, read_training_runs([tmp_path]).of_task(PUSH))
    assert row.unsolved_seeds == [0]
    assert row.steps_to_solved is not None
    assert row.steps_to_solved.text() == "> 562,500 (1 of 2 never)"


def test_unfinished_runs_are_not_counted(tmp_path: Path) -> None:
    write_run(tmp_path, PUSH, "early", 0, curve(20))
    write_run(tmp_path, PUSH, "early", 1, curve(2), finished=False)
    [row] = summarize(PUSH, read_training_runs([tmp_path]).of_task(PUSH))
    assert (row.n, len(row.under_way)) == (1, 1)
    assert row.to_mapping()["under_way"] == [{"seed": 1, "steps": 40 * EVERY}]


def test_files_without_optional_entries_are_read(tmp_path: Path) -> None:
    points = [{"steps": 10, "success_rate": 0.0}, {"steps": 20, "success_rate": 0.5}]
    advice = {"strategy": "mc-q", "threshold": 0.05}
    config = {"env_id": PUSH, "seed": 3, "advice": advice, "total_steps": 30}
    bare = {"kind": "training-run", "config": config, "curve": points}
    (tmp_path / "bare.json").write_text(json.dumps(bare))
    [run] = read_training_runs([tmp_path]).runs
    assert (run.name, run.task, run.row, run.seed) == ("bare", PUSH, "mc-q 0.05", 3)
    assert not run.finished
    assert run.final_success is None
    assert run.collisions is None
    assert (run.advice_spent, run.advice_over) == (0, None)
    assert run.spent_before is None  # advised, by a teacher of unknown training
    assert run.metrics_with_teacher is None
    [row] = summarize(PUSH, {run.row: [run]})
    assert row.n == 0


def test_more_arms_are_another_task(tmp_path: Path) -> None:
    config = {"env_id": PUSH, "seed": 0, "advice": {"strategy": "early"}}
    for name, options in (("two", {}), ("three", {"n_arms": 3})):
        told = config | {"env_kwargs": options}
        path = write_run(tmp_path, PUSH, "early", 0, curve(9), config=told)
        path.rename(tmp_path / f"{name}.json")
    results = read_training_runs([tmp_path])
    assert set(results.of_task(PUSH)) == {"early"}
    assert set(results.of_task(f"{PUSH}, n_arms=3")) == {"early"}
    assert set(tables(results)) == {PUSH, f"{PUSH}, n_arms=3"}


def test_other_settings_of_a_row_are_told_apart(tmp_path: Path) -> None:
    def write(
        group: str, row: str, seed: int = 0, advice: object = None, **settings: object
    ) -> None:
        config = {
            "env_id": PUSH,
            "seed": seed,
            "advice": advice,
            "per_arm_critics": True,
            **settings,
        }
        path = write_run(tmp_path, PUSH, row, seed, curve(9), group=group, config=config)
        path.rename(tmp_path / f"{group}-{path.name}")

    early, loose = {"strategy": "early"}, {"strategy": "mc-q", "threshold": 0.01}
    for group, per_arm_critics in (("push", True), ("push-joint-value", False)):
        write(group, "none", per_arm_critics=per_arm_critics)
        write(group, "early", advice=early, per_arm_critics=per_arm_critics)
    # A setting that an older file does not have has its default.
    write("push-thresholds", "mc-q 0.01", advice=loose, relabel_probability=0.8)
    write("push-baselines", "cloned", imitation_weight=1.0)
    results = read_training_runs([tmp_path])
    assert not results.skipped
    assert set(results.of_task(PUSH)) == {
        *("none", "early", "mc-q 0.01", "cloned"),
        *("none (push-joint-value)", "early (push-joint-value)"),
    }
    # A row that the main group has not run yet keeps its name free.
    (tmp_path / f"push-{PUSH}-early-0.json").unlink()
    rows = read_training_runs([tmp_path]).of_task(PUSH)
    assert "early" not in rows
    assert "early (push-joint-value)" in rows


def test_damaged_files_are_named_and_left_out(tmp_path: Path) -> None:
    good = write_run(tmp_path, PUSH, "early", 0, curve(20))
    (tmp_path / "cut.json").write_text(good.read_text()[:500])
    (tmp_path / "empty.json").write_text("")
    (tmp_path / "list.json").write_text("[1]")
    (tmp_path / "other.json").write_text('{"kind": "speed"}')
    write_run(tmp_path, PUSH, "none", 1, curve(20), curve=[])
    write_run(tmp_path, PUSH, "none", 2, curve(20), curve=[{"steps": 1}])
    write_run(tmp_path, PUSH, "none", 3, curve(20), teacher_steps="many")
    (tmp_path / "twin.json").write_text(good.read_text())
    (tmp_path / "run.json.partial").write_text("{")
    (tmp_path / "table.json").write_text('{"kind": "advising"}')  # our own, made from the others
    results = read_training_runs([tmp_path])
    assert [run.name for run in results.runs] == ["early-0"]
    reasons = {one.file: one.reason for one in results.skipped}
    assert len(reasons) == 8
    assert "truncated" in reasons["cut.json"]
    assert "truncated" in reasons["empty.json"]
    assert "kind" in reasons["list.json"]
    assert "'speed'" in reasons["other.json"]
    assert "at least one" in reasons[f"{PUSH}-none-1.json"]
    assert "success_rate" in reasons[f"{PUSH}-none-2.json"]
    assert "many" in reasons[f"{PUSH}-none-3.json"]
    assert "already in early-0" in reasons["twin.json"]


def test_the_whole_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "runs"
    folder.mkdir()
    for seed in range(2):
        write_run(folder, PUSH, "none", seed, curve(30 + seed, best=0.5))
        write_run(folder, PUSH, "early", seed, curve(10 + seed))
        write_run(folder, PUSH, "mc-q 0.1", seed, curve(6 + seed))
    busy = [
        {**point, "load_average": load} for point, load in zip(curve(12), [1, 9] * 20, strict=True)
    ]
    write_run(folder, PUSH, "random", 0, busy)
    write_run(folder, PUSH, "mc-q 0.01", 0, curve(12), finished=False)
    write_run(folder, PICK, "none", 0, curve(12))
    write_run(folder, "JacoPush-v0", "none", 0, curve(3))
    evaluation = {"kind": "evaluation", "env": PUSH, "policy": "side-by-side:jaco-push"}
    evaluation |= {"episodes": 100, "success_rate": 0.83, "ci95": [0.745, 0.891]}
    evaluation["env_kwargs"] = {"n_arms": 3}
    (folder / "side.json").write_text(json.dumps(evaluation))
    (folder / "cut.json").write_text('{"kind"')
    page, drawn, data = tmp_path / "page.md", tmp_path / "figures", tmp_path / "all.json"
    words = ["advising", "--results", folder, "--table", page, "--figures", drawn]
    assert reproduce([*map(str, words), "--json", str(data)]) == 0
    out = capsys.readouterr().out
    assert "left out cut.json" in out
    text = page.read_text()
    # The paper's row beside ours, and a row that the paper does not have.
    assert "| 63 | 229 | 0.9583 | 0.0030 |" in text
    assert "| random | 1 |" in text
    assert "> 1,000,000 (2 of 2 never)" in text
    assert "| 100,000 | 40.0 | 5.0 |" in text
    assert f"| {PUSH}, n_arms=3 | side-by-side:jaco-push | 100 | 0.830" in text
    assert "mc-q 0.01 seed 0" in text
    assert "- `cut.json` is not JSON" in text
    assert "| push | one arm | 1 |" in text
    names = {path.name for path in drawn.iterdir()}
    assert names == {f"figure-5-{k}.png" for k in range(4, 9)} | {"figure-baselines.png"}
    for name in names:
        assert f"(figures/{name})" in text
    content = json.loads(data.read_text())
    assert content["kind"] == "advising"
    assert content["provenance"].keys() >= {"command", "commit"}
    flat = {(row["task"], row["row"]): row for row in content["rows"]}
    assert flat[PUSH, "none"]["steps_to_solved"] is None
    assert flat[PUSH, "mc-q 0.1"]["n"] == 2
    assert flat[PUSH, "mc-q 0.01"]["n"] == 0
    verdicts = {(one["claim"], one["task"]): one["verdict"] for one in content["findings"]}
    assert {name for name, verdict in verdicts.items() if verdict != "cannot be told"} == {
        ("all advice beats none", "push"),
        ("MC-Q is first by ELR", "push"),
    }
    assert set(verdicts.values()) == {"cannot be told", "holds so far"}
    # A table of the same files is the same.
    results = read_training([folder])
    assert json.loads(
        json.dumps(figures(tables(results), evaluate_findings(tables(results)), results))
    ) == {key: value for key, value in content.items() if key != "provenance"}


def test_nothing_to_show_is_an_error_that_says_why(tmp_path: Path) -> None:
    (tmp_path / "cut.json").write_text("{")
    with pytest.raises(UsageError, match=r"no training run in .*cut\.json is not JSON"):
        read_training([tmp_path])
    with pytest.raises(UsageError, match="does not exist"):
        read_training([tmp_path / "nowhere"])


def test_mean_curves_lie_between_their_seeds(tmp_path: Path) -> None:
    write_run(tmp_path, PUSH, "early", 0, curve(10, evaluations=30))
    write_run(tmp_path, PUSH, "early", 1, curve(12))
    bare = [{**point, "mean_q": None} for point in curve(14)]
    write_run(tmp_path, PUSH, "early", 2, bare)
    runs = read_training_runs([tmp_path]).of_task(PUSH)["early"]
    found = mean_curve(runs, "success_rate")
    assert found is not None
    steps, means = found
    assert steps[-1] == 30 * EVERY  # what all seeds did
    expected = sum(run.points[9]["success_rate"] for run in runs) / 3
    assert means[steps.tolist().index(10 * EVERY)] == pytest.approx(expected)
    of_q = mean_curve(runs, "mean_q")
    assert of_q is not None
    assert of_q[1][0] == pytest.approx(
        (runs[0].points[0]["mean_q"] + runs[1].points[0]["mean_q"]) / 2
    )
    assert mean_curve(runs[2:], "mean_q") is None


def test_panels_draw_every_seed_and_their_mean(tmp_path: Path) -> None:
    for seed in range(3):
        write_run(tmp_path, PUSH, "mc-q 0.1", seed, curve(6 + seed))
    write_run(tmp_path, PUSH, "none", 0, curve(12))
    by_row = read_training_runs([tmp_path]).of_task(PUSH)
    panels = strategies(by_row)
    assert [panel.title for panel in panels] == ["strategies", "mc-q, by threshold"]
    figure = draw_panels([*panels, Panel("empty", {})])
    axes = [one for one in figure.axes if one.get_visible()]
    assert [one.get_title(loc="left") for one in axes] == [
        *("strategies", "mc-q, by threshold", "empty")
    ]
    # Three thin seeds and their mean, one line for the single run, and the level of 0.9.
    assert len(axes[0].lines) == 4 + 1 + 1
    legend = axes[0].get_legend()
    assert legend is not None
    assert [one.get_text() for one in legend.get_texts()] == ["none (n = 1)", "mc-q 0.1 (n = 3)"]


def test_a_row_has_the_same_colour_in_every_panel(tmp_path: Path) -> None:
    for row in ("none", "early", "mc-q 0.1", "mc-act 0.1"):
        write_run(tmp_path, PUSH, row, 0, curve(6))
    rows = read_training_runs([tmp_path]).of_task(PUSH)
    panels = [
        Panel("one", {name: rows[name] for name in ("none", "early", "mc-q 0.1")}, "none"),
        Panel("two", {name: rows[name] for name in ("none", "mc-act 0.1", "mc-q 0.1")}, "none"),
    ]
    first, second = (
        {str(line.get_label()).split(" (")[0]: line.get_color() for line in axes.lines}
        for axes in draw_panels(panels).axes
    )
    assert first["none"] == second["none"]
    assert first["mc-q 0.1"] == second["mc-q 0.1"]
    # And no two of a panel share one.
    for found in (first, second):
        named = [colour for label, colour in found.items() if not label.startswith("_")]
        assert len(set(named)) == len(named) == 3


def test_curves_beyond_the_colours_are_told_apart_by_dashes(tmp_path: Path) -> None:
    labels = [f"mc-q 0.{index}" for index in range(10)]
    for label in labels:
        write_run(tmp_path, PUSH, label, 0, curve(6))
    rows = read_training_runs([tmp_path]).of_task(PUSH)
    (axes,) = draw_panels([Panel("many", {label: rows[label] for label in labels})]).axes
    drawn = {
        (line.get_color(), line.get_linestyle())
        for line in axes.lines
        if str(line.get_label()).startswith("mc-q")
    }
    assert len(drawn) == len(labels)
