"""Readers of results of retrievers and of chains, of lists made elsewhere, and of what a probe measured."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from fuzz.asking import asks, command, write
from fuzz.datasets import ACROSS
from fuzz.parser import Parser, Place, Read

_RETRIEVAL = ("evaluate-retrieval", "--radius", 0.2)
_CHAIN = ("evaluate-relocalization", "-r", "oracle", "-m", "good=pipelines_for_tests:Knows", "--top", 1)


def write_records(root: Path) -> None:
    """A dataset, results of a retriever and of a chain on it, lists as hloc has them, and radii of a probe."""
    from made_radii import write_radii
    from small_dataset import make_small_dataset

    dataset = make_small_dataset(root / "ds", frames=3, size=(24, 18))
    common = ("-d", root / "ds", "-q")
    command(*_RETRIEVAL, *common, "-m", "t=retrievers_for_tests:Thumbnail", "-o", root / "retrieval")
    command(*_CHAIN, *common, "-o", root / "chains", "-j", 1)
    times = {name: dataset.traversal(name).timestamps("cam0") for name in ("summer", "winter")}
    names = {name: [f"traversals/{name}/images/cam0/{t}.png" for t in found] for name, found in times.items()}
    write(root / "lists" / f"{ACROSS}.txt", *(f"{q} {g}" for q in names["winter"] for g in names["summer"]))
    rows = (("good", what, "across conditions", 1.5) for what in ("translation", "rotation"))
    write_radii(root / "probe" / "radii.csv", *rows)
    write(
        root / "tables" / "page.md",
        "# Results",
        "",
        "| method | R@1 | AP |",
        "|---|---:|---:|",
        "| a | 75.0 | 80.5 |",
        "| b | 10 ± 2 | 12 |",
    )
    write(root / "tables" / "page.csv", "method;R@1;AP", "a;75.0;80.5", "b;10;12")


def _tables(page: str) -> None:
    from relocbench.errors import PredictionError
    from relocbench.metrics.retrieval.tables import read_tables

    try:
        read_tables(page)
    except ValueError as bad:  # it knows no file, and says so to whoever does
        raise PredictionError(str(bad)) from None


def _reads(name: str) -> Read:
    """A reader of one file, imported when it is used."""

    def run(place: Place) -> None:
        from relocbench.evaluation.relocalization import answers as pipeline_answers
        from relocbench.evaluation.relocalization.basin import read_basins
        from relocbench.evaluation.relocalization.records import PipelineResults, PipelineSetResults
        from relocbench.evaluation.retrieval import answers as retrieval_answers
        from relocbench.evaluation.retrieval.records import RetrieverResults, SetResults

        folder, target = place.target.parent, place.target
        page = target.read_text(encoding="utf-8", errors="replace") if target.is_file() else ""  # tables come as text
        readers: dict[str, Callable[[], object]] = {
            "set": lambda: SetResults(folder).record,
            "run": lambda: RetrieverResults(folder).run_record(),
            "scores": lambda: RetrieverResults(folder).retrieval_scores(),
            "answers": lambda: retrieval_answers.ANSWERS.read(place.target),
            "chain-set": lambda: PipelineSetResults(folder).record,
            "chain-run": lambda: PipelineResults(folder).run_record(),
            "chain-scores": lambda: PipelineResults(folder).scores(),
            "chain": lambda: pipeline_answers.errors_of(pipeline_answers.PIPELINE.read(place.target)),
            "basins": lambda: read_basins(place.target),
            "tables": lambda: _tables(page),
        }
        readers[name]()

    return run


def _lists(place: Place) -> None:
    from relocbench.evaluation.retrieval.answers import read_lists

    def keys(name: str) -> dict[str, int]:
        found = sorted((place.root / "ds" / "traversals" / name / "images" / "cam0").iterdir())
        return {path.relative_to(place.root / "ds").as_posix(): i for i, path in enumerate(found)}

    read_lists(place.target, keys("winter"), keys("summer"))


def _retrieval_board(place: Place) -> Iterable[str]:
    from relocbench.leaderboard import displays
    from relocbench.leaderboard.common.by_query import load_board
    from relocbench.leaderboard.retrieval.board import RETRIEVAL
    from relocbench.leaderboard.retrieval.page import retrieval_page

    board = load_board(RETRIEVAL, place.root / "retrieval")
    if board is not None:
        displays.RETRIEVAL.records(board)
        retrieval_page(board)
    return ()


def _pipeline_board(place: Place) -> None:
    from relocbench.leaderboard import displays
    from relocbench.leaderboard.common.by_query import load_board
    from relocbench.leaderboard.relocalization.board import RELOCALIZATION
    from relocbench.leaderboard.relocalization.page import relocalization_page

    board = load_board(RELOCALIZATION, place.root / "chains")
    if board is not None:
        displays.RELOCALIZATION.records(board)
        relocalization_page(board)


SEEDS = {"records": write_records}
_CHAINS = "chains/*relocalization@*/*+*"
PARSERS = (
    Parser("retrieval.yaml", "records", ("retrieval/*/retrieval.yaml",), _reads("set"), text=True),
    Parser("retrieval-run.yaml", "records", ("retrieval/*/t/run.yaml",), _reads("run"), text=True),
    Parser("retrieval-scores.yaml", "records", ("retrieval/*/t/scores.yaml",), _reads("scores"), text=True),
    Parser("retrieval-answers.csv", "records", ("retrieval/*/t/*.csv",), _reads("answers"), text=True),
    Parser("retrieval-lists", "records", ("lists/*.txt",), _lists, text=True),
    Parser("retrieval-tables", "records", ("tables/*",), _reads("tables"), text=True),
    Parser("relocalization.yaml", "records", ("chains/*/relocalization.yaml",), _reads("chain-set"), text=True),
    Parser("chain-run.yaml", "records", (f"{_CHAINS}/run.yaml",), _reads("chain-run"), text=True),
    Parser("chain-scores.yaml", "records", (f"{_CHAINS}/scores.yaml",), _reads("chain-scores"), text=True),
    Parser("chain-answers.csv", "records", (f"{_CHAINS}/*.csv",), _reads("chain"), text=True),
    Parser("probe-radii", "records", ("probe/radii.csv",), _reads("basins"), text=True),
    Parser(
        "retrieval-leaderboard",
        "records",
        ("retrieval/*/*.yaml", "retrieval/*/t/*"),
        _retrieval_board,
        names=True,
        brief=False,
    ),
    Parser(
        "chain-leaderboard", "records", ("chains/*/*.yaml", f"{_CHAINS}/*"), _pipeline_board, names=True, brief=False
    ),
    Parser(
        "records-command",
        "records",
        ("chains/*/*.yaml", f"{_CHAINS}/*"),
        asks("leaderboard", "{root}/chains", "--out", "{out}/b", "-q"),
        names=True,
        brief=False,
    ),
    Parser(
        "lists-command",
        "records",
        ("lists/*",),
        asks(
            *_RETRIEVAL,
            "-d",
            "{root}/ds",
            "--predictions",
            "{root}/lists",
            "-m",
            "l",
            "-o",
            "{out}/r",
            "-q",
        ),
        names=True,
        brief=False,
    ),
)
