"""Options and fixtures of the pytest plugin; everything heavy waits for the first use."""

import os
import re
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from twin.regression.checker import Regression
    from twin.regression.truth import Truths

_NOTES = pytest.StashKey[list[str]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Two options, both about baselines."""
    group = parser.getgroup("twin", "regression against rendered truth")
    group.addoption(
        "--update-baseline",
        metavar="REASON",
        help="make or replace the baselines of the tests run; the reason is stored with them",
    )
    group.addoption(
        "--regression-pictures",
        metavar="DIR",
        default="regression-pictures",
        help="where pictures of what became worse are written (default: %(default)s)",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Refuse an update without a reason, before any test runs."""
    reason = config.getoption("--update-baseline")
    if reason is not None and (not reason.strip() or os.path.exists(reason)):
        raise pytest.UsageError(
            f"--update-baseline: {reason!r}: expected the reason, in words, which is stored"
        )
    config.stash[_NOTES] = []


def pytest_sessionfinish(session: pytest.Session) -> None:
    """A worker of pytest-xdist has no terminal: its notes go to the process that has."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["twin_regression"] = session.config.stash[_NOTES]


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take a worker's notes; one that died has none."""
    node.config.stash[_NOTES] += getattr(node, "workeroutput", {}).get("twin_regression", [])


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say which baselines were written, and which could be."""
    notes = terminalreporter.config.stash[_NOTES]
    if notes:
        terminalreporter.section("baselines")
        for note in notes:
            terminalreporter.line(note)


@pytest.fixture(scope="session")
def twin_truth(request: pytest.FixtureRequest) -> "Truths":
    """Rendered truth, kept in pytest's cache from run to run."""
    from twin.kept_results import KeptResults
    from twin.regression.truth import Truths

    if hasattr(request.config, "cache") and request.config.cache is not None:
        return Truths(KeptResults(request.config.cache.mkdir("twin-truth")))
    factory = request.getfixturevalue("tmp_path_factory")  # with -p no:cacheprovider
    return Truths(KeptResults(factory.mktemp("twin-truth")))


@pytest.fixture
def twin_regression(request: pytest.FixtureRequest, twin_truth: "Truths") -> "Regression":
    """Compares methods with baselines; see `twin.regression`."""
    from twin.regression.checker import Regression

    config, file = request.config, request.path
    _, _, within = request.node.nodeid.partition("::")  # with the class, if there is one
    name = re.sub(r"[^\w.-]+", "-", within).strip("-")
    return Regression(
        truths=twin_truth,
        baselines=file.parent / "baselines",
        pictures=config.rootpath / config.getoption("--regression-pictures"),
        test=f"{file.stem}-{name}",
        node=request.node.nodeid,
        reason=config.getoption("--update-baseline"),
        notes=config.stash[_NOTES],
    )
