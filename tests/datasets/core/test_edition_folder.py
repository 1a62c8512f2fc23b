"""A folder of an edition where a dataset is expected: its districts, or one clear line."""

import shutil
from pathlib import Path

import pytest
from command_line import relocbench
from small_dataset import make_small_dataset

from relocbench.datasets.core.edition_folder import EditionFile, TierRecord, datasets_of, write_edition


@pytest.fixture
def edition(tmp_path: Path) -> Path:
    """Of one tier with two districts."""
    root = tmp_path / "edition"
    for number, seed in (("01", 0), ("02", 1)):
        make_small_dataset(root / "easy" / number, name=f"district-{number}", seed=seed)
    record = TierRecord(questions="none", datasets={"01": "one", "02": "two"})
    write_edition(root, EditionFile(edition="small", split="validation", districts=2, tiers={"easy": record}))
    return root


@pytest.mark.thorough
def test_a_tier_is_known_from_inside_and_a_dataset_beside_another_file_of_this_name_is_itself(
    edition: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(edition / "easy")
    assert datasets_of(Path()) == [Path("01"), Path("02")]
    (edition / "easy" / "edition.yaml").write_text("second printing")
    assert datasets_of(edition / "easy" / "01") == [edition / "easy" / "01"]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("tiers: {}", "no tier is finished; run `relocbench build-dataset edition small` again"),
        ("tiers: {easy: {questions: q, datasets: {'03': c}}}", "03 is missing or not finished; run"),
        ("tiers: {easy: {questions: q, datasets: {'../../other': c}}}", "edition.yaml:4"),
        ("tiers: {../other: {questions: q, datasets: {}}}", "edition.yaml:4"),
    ],
)
def test_an_edition_that_is_not_whole_is_refused_before_anything_is_asked(
    edition: Path, text: str, complaint: str
) -> None:
    (edition / "edition.yaml").write_text(f"edition: small\nsplit: validation\ndistricts: 2\n{text}\n")
    refused = relocbench("evaluate", "-d", edition, "-m", "identity", "--out", edition.parent / "results")
    assert refused.status == 2
    assert complaint in refused.complaint
    assert not (edition.parent / "results").exists()


def test_every_district_of_an_edition_is_validated(edition: Path) -> None:
    assert relocbench("validate", edition, "--quick").out.splitlines()[-1] == f"{edition}: no fault (edition)"
    shutil.rmtree(edition / "easy" / "02" / "traversals")
    found = relocbench("validate", edition / "easy", "--quick")
    assert found.status == 2
    assert str(edition / "easy" / "02") in found.out


@pytest.mark.thorough
def test_results_on_a_whole_edition_are_shown_together_and_scored_again_with_its_datasets(
    edition: Path, tmp_path: Path
) -> None:
    results = tmp_path / "results"
    evaluated = relocbench("evaluate", "-d", edition, "-m", "identity", "--out", results, "--workers", "0")
    assert evaluated.status == 0
    titles = [line for line in evaluated.out.splitlines() if "(" in line]
    assert titles
    assert all(title.startswith("2 datasets, ") for title in titles)
    board = relocbench("leaderboard", results, "-d", edition, "--out", tmp_path / "board")
    assert board.status == 0, board.err


def test_where_a_district_cannot_be_scored_each_is_shown_for_itself(edition: Path, tmp_path: Path) -> None:
    shutil.rmtree(edition / "easy" / "02")
    make_small_dataset(edition / "easy" / "02", name="district-02", truth=False)
    evaluated = relocbench("evaluate", "-d", edition, "-m", "identity", "--out", tmp_path / "results", "--workers", "0")
    assert evaluated.status == 0
    assert "district-01: " in evaluated.out
    assert "ground truth is withheld" in evaluated.err


def test_predictions_of_one_dataset_are_refused_for_several(edition: Path) -> None:
    results = edition.parent / "results"
    refused = relocbench("evaluate", "-d", edition, "--predictions", edition, "-m", "mine", "--out", results)
    assert refused.status == 2
    assert (
        f"--predictions are of one dataset; name one of the 2, such as {edition / 'easy' / '01'}" in refused.complaint
    )
    assert not results.exists()
