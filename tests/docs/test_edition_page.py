"""The page of an edition follows from the predictions and errors that are published beside it."""

from __future__ import annotations

import shutil
from argparse import Namespace
from pathlib import Path

import archives
import edition_page
import pandas as pd
import pytest
import recompute
import tiers
from command_line import relocbench
from groups import METRICS, Group
from small_dataset import ACROSS, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.edition_folder import EditionFile, TierRecord, datasets_of, questions_of, write_edition
from relocbench.datasets.importers.edition.dataset import recipe
from relocbench.errors import RelocbenchError
from relocbench.evaluation.common.results import MethodResults, write_record
from relocbench.evaluation.tracking.score import predictions_hash

NAME = "2026.1-validation"


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two districts of an edition in ``districts``, results on them, and the published page with its predictions."""
    root = tmp_path_factory.mktemp("published")
    for number in ("01", "02"):
        folder = root / "districts" / "easy" / number
        make_small_dataset(
            folder, name=f"relocbench-{NAME}-easy-{number}", seed=int(number), within=False, correspondences=50
        )
    ids = {path.name: Dataset(path).content_id for path in (root / "districts" / "easy").iterdir()}
    record = TierRecord(questions=questions_of(ids), datasets=dict(sorted(ids.items())))
    write_edition(
        root / "districts",
        EditionFile(edition="2026.1", split="validation", districts=2, tiers={"easy": record}),
    )
    asked = relocbench(
        "evaluate", "-d", root / "districts", "-m", "identity", "-m", "orb-pnp", "-o", root / "results", "-j", 0, "-q"
    )
    assert asked.status == 0, asked.err
    for district in datasets_of(root / "districts"):
        tiers.bound(district, root / "results")
    out = root / "board" / "edition"
    edition_page.pack_tier(root / "results", "2026.1", "validation", "easy", out / "predictions" / NAME)
    (out / f"{NAME}.md").write_text(edition_page.page(recipe("2026.1"), "validation", root / "results"))
    return root


@pytest.mark.thorough
def test_the_page_shows_each_method_on_each_tier_and_what_was_asked(published: Path) -> None:
    text = (published / "board" / "edition" / f"{NAME}.md").read_text()
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    cells = {row[0]: row[1] for row in reversed(rows) if len(row) > 1}
    districts = [Dataset(path) for path in datasets_of(published / "districts")]
    pairs = sum(len(district.pair_set(ACROSS).pairs) for district in districts)
    assert (cells["method"], cells["*pairs*"], cells["*districts*"]) == ("easy", f"*{pairs}*", "*2*")
    assert cells["true-matches"].startswith("100.0")
    assert "this is no result of the edition" in text
    assert "which no whole edition has" in text
    assert questions_of({f"{n:02d}": d.content_id for n, d in enumerate(districts, 1)}) in text


def test_only_districts_that_are_not_published_are_asked(
    published: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On another machine, whose pixels may differ, the published answers stand beside those to the other districts."""
    easy = tmp_path / "scratch" / NAME / "easy"
    shutil.copytree(published / "districts", easy.parent)
    (easy / "02").rename(tmp_path / "other")
    make_small_dataset(easy / "02", name=f"relocbench-{NAME}-easy-02", seed=3, within=False, correspondences=50)
    asked = []
    monkeypatch.setattr(edition_page, "run", lambda *words: None)
    monkeypatch.setattr(edition_page, "pack_tier", lambda *words: None)
    monkeypatch.setattr(tiers, "evaluate", lambda folder, results, workers: asked.append(folder))
    options = Namespace(scratch=tmp_path / "scratch", split="validation", tiers=["easy"], districts=None, workers=1)
    edition_page.make(recipe("2026.1"), published / "board" / "edition" / "predictions" / NAME, options)
    assert asked == [easy / "02"]
    for path in (published / "results").rglob("*.txt"):
        restored = tmp_path / "scratch" / "results" / path.relative_to(published / "results")
        assert restored.read_bytes() == path.read_bytes()


def test_a_damaged_archive_is_named(published: Path, tmp_path: Path) -> None:
    whole = next((published / "board" / "edition" / "predictions").rglob("orb-pnp.tar.xz")).read_bytes()
    damaged = tmp_path / "easy" / "orb-pnp.tar.xz"
    damaged.parent.mkdir()
    damaged.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SystemExit, match=r"orb-pnp\.tar\.xz: expected a whole archive"):
        archives.unpack(tmp_path, tmp_path / "results")


def test_a_pair_counts_for_the_weather_at_either_end() -> None:
    """A night's pair with rain counts for both; a soft rain is not the condition Rain."""
    sets = {
        "t-Rain-0__t-Night-0__front": 1.0,
        "t-Night-0__t-Sunny-0__front": 0.0,
        "t-Sunny-0__t-SoftRainNoon-0__front": 1.0,
    }
    rows = [
        {"method": "m", "district": "d", "pair_set": name, "step": step, **dict.fromkeys(METRICS, right)}
        for name, right in sets.items()
        for step in range(4)
    ]
    lines = list(edition_page.by_weather([Group("hard", pd.DataFrame(rows))]))
    assert "| method | Rain | Night | none of these |" in lines
    assert "| *pairs* | *4* | *8* | *4* |" in lines
    cells = next(line for line in lines if line.startswith("| m |")).strip("| ").split(" | ")
    assert [float(cell.split()[0]) for cell in cells[1:]] == [100.0, 50.0, 100.0]
    assert list(edition_page.by_weather([Group("hard", pd.DataFrame([{**rows[-1], "pair_set": "a__b__front"}]))])) == []


@pytest.mark.thorough
def test_the_page_is_printed_again_from_errors_and_from_predictions(published: Path, tmp_path: Path) -> None:
    page = published / "board" / "edition" / f"{NAME}.md"
    from_errors, untried = recompute.edition(page, tmp_path, render=False)
    assert (from_errors.outcome, from_errors.differs) == ("byte-equal", False)
    assert untried.outcome.startswith("not recomputed")
    assert recompute.edition_again(page, tmp_path, published / "districts").outcome == "byte-equal"


@pytest.mark.thorough
@pytest.mark.parametrize("hidden", [False, True], ids=["a changed file", "with its digest"])
def test_a_changed_prediction_is_noticed(published: Path, tmp_path: Path, hidden: bool) -> None:
    """Whoever changes a digest as well is found out by the truth alone."""
    forged = archives.unpack(published / "board" / "edition" / "predictions" / NAME, tmp_path / "forged")
    folder = MethodResults(sorted(forged.glob("*-01@*"))[0] / "identity")
    path = folder.predictions(ACROSS)
    lines = path.read_text().splitlines()
    columns = lines[-1].split()
    path.write_text("\n".join([*lines[:-1], " ".join([*columns[:2], "9.5", *columns[3:]])]) + "\n")
    if hidden:
        scores = folder.score_record()
        renewed = {**scores.predictions, ACROSS: predictions_hash(folder, ACROSS)}
        write_record(folder.scores_yaml, scores.model_copy(update={"predictions": renewed}))
    page = tmp_path / "edition" / f"{NAME}.md"
    edition_page.pack_tier(forged, "2026.1", "validation", "easy", page.parent / "predictions" / NAME)
    page.write_bytes((published / "board" / "edition" / page.name).read_bytes())
    if hidden:
        assert not recompute.edition_again(page, tmp_path / "scratch").differs
    finding = recompute.edition_again(page, tmp_path / "scratch", published / "districts" if hidden else None)
    assert finding.differs
    assert ACROSS in finding.outcome


def test_districts_that_ask_something_else_prove_nothing(published: Path, tmp_path: Path) -> None:
    make_small_dataset(tmp_path / "other", name="other")
    with pytest.raises(RelocbenchError, match="easy-01 is not among"):
        edition_page.page(recipe("2026.1"), "validation", published / "results", tmp_path / "other")


def test_a_method_that_was_not_asked_of_all_pairs_has_no_share(published: Path) -> None:
    rows = tiers.answers(published / "results")
    partly = rows[(rows["method"] != "orb-pnp") | rows["district"].str.endswith("-01")]
    (group,) = tiers.groups(partly)
    assert group.methods == {"identity", "true-matches"}
    assert "| orb-pnp |  |" in tiers.table([group])
