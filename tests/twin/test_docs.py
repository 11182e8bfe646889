"""What the tour and the glossary name exists, and the walks give what the tour says."""

import re
from pathlib import Path
from urllib.parse import urlsplit

import pytest

ROOT = Path(__file__).parents[2]
TOUR = (ROOT / "docs" / "tour.md").read_text()
GLOSSARY = (ROOT / "docs" / "glossary.md").read_text()


def pins(lock: str) -> dict[str, str]:
    lines = re.findall(r"^([\w.-]+)==(\S+?);?$", (ROOT / lock).read_text(), re.MULTILINE)
    return {re.sub(r"[-_.]+", "-", name).lower(): version for name, version in lines}


def test_the_site_is_built_with_the_versions_that_the_project_has() -> None:
    ours, site = pins("requirements.lock"), pins("requirements-docs.lock")
    shared = ours.keys() & site.keys()
    assert len(shared) > 20
    assert {name: ours[name] for name in shared} == {name: site[name] for name in shared}


#: Sites that pages link to: projects' own, and one post that no other place has.
SITES = {"1px-vision.com", "doi.org", "foxglove.dev", "mcap.dev"}


def test_links_to_elsewhere_are_few_and_whole() -> None:
    """Whether they still lead somewhere `make docs-links` asks; here, without a network, that each
    is an https address of a site that stays, and each DOI one that could be.
    """
    pages = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CITATION.cff"]
    text = "\n".join(p.read_text() for p in [*pages, *(ROOT / "docs").rglob("*.md")])
    links = [urlsplit(link) for link in re.findall(r"\bhttps?://[^\s)>\"`\]]+", text)]
    elsewhere = [link for link in links if link.hostname not in ("127.0.0.1", "localhost")]
    assert len(elsewhere) >= 3
    assert {link.scheme for link in elsewhere} == {"https"}
    assert {link.hostname for link in elsewhere} <= SITES
    dois = re.findall(r"\b(?:doi:? ?|doi\.org/)(1\S*)", text, re.IGNORECASE)
    assert [doi for doi in dois if not re.match(r"10\.\d{4,9}/\S+", doi)] == []


def test_every_topic_of_a_log_is_in_the_reference() -> None:
    said = (ROOT / "docs" / "_ext" / "reference_formats.py").read_text()
    code = [p.read_text() for name in ("twin", "hardware") for p in (ROOT / name).rglob("*.py")]
    topics = set(re.findall(r'"(/(?:tf|spi|radar|truth)(?:_static)?(?:/\w+)*)"', "".join(code)))
    assert len(topics) >= 6
    assert {topic for topic in topics if f"`{topic}`" not in said} == set()


def test_the_drawing_of_the_rooms_is_that_of_its_source() -> None:
    """`dot` draws it, which no build needs: every arrow and room of the source is in the drawing,
    and every room is a package or a folder.
    """
    source = (ROOT / "docs" / "rooms.dot").read_text()
    drawn = (ROOT / "docs" / "rooms.svg").read_text()
    arrows = re.findall(r"(\w+) -> (\w+)", source)
    assert len(arrows) >= 15
    assert sorted(re.findall(r"<title>(\w+)&#45;&gt;(\w+)</title>", drawn)) == sorted(arrows)
    rooms = re.findall(r'(?<!-> )\b\w+ \[label="([^"]*)"', source)
    assert len(rooms) >= 15
    for room in "\\n".join(rooms).split("\\n"):
        assert f">{room}</text>" in drawn
        assert (ROOT / room.replace(".", "/")).is_dir(), room


def packages() -> set[str]:
    found = (p.parent for name in ("twin", "hardware") for p in (ROOT / name).rglob("__init__.py"))
    return {".".join(folder.relative_to(ROOT).parts) for folder in found}


def exists(dotted: str) -> bool:
    """Whether a module, or a name written in one, is there; nothing is imported."""
    parts = dotted.split(".")
    for n in range(len(parts), 0, -1):
        place = ROOT.joinpath(*parts[:n])
        files = [place.with_suffix(".py"), place / "__init__.py"]
        if file := next((file for file in files if file.is_file()), None):
            return all(re.search(rf"\b{name}\b", file.read_text()) for name in parts[n:])
    return False


def test_every_package_has_a_line_in_the_tour() -> None:
    assert {p for p in packages() if f"| `{p}` |" not in TOUR} == set()


def test_what_is_named_is_there() -> None:
    for text in (TOUR, GLOSSARY):
        names = set(re.findall(r"`((?:twin|hardware)(?:\.\w+)+)`", text)) - {"twin.catalog"}
        assert [name for name in names if not exists(name)] == []
    for path in re.findall(r"`((?:twin|hardware)/[\w/.]+)`", TOUR):
        assert (ROOT / path).exists(), path


def test_what_the_walks_name_in_a_room_is_there() -> None:
    room = ""
    for line in TOUR.splitlines():
        if match := re.match(r"\| (?:(?:\d `([\w.]+)`)|) ?\| (`[^|]*) \|", line):
            room = match[1] or room
            for name in re.findall(r"`([\w.]+)`", match[2]):
                assert exists(f"{room}.{name}"), (room, name)


def figures_of_the_camera() -> dict[str, float]:
    """Those that the table of the camera's walk prints, by the names in its block."""
    patterns = {
        "mean_e": r"mean electrons, .* \| ([\d ]+) e- \|",
        "count": r"`counts` \| ([\d ]+) \|",
        "electrons": r"`offset_counts`\) .* \| ([\d ]+) e- \|",
        "value": r"`values` \| (-[\d ]+) e- \|",
        "cell_e": r"cell \(22, 24\): (\d+) \+- \d+ e- \|",
        "truth_e": r"`Score` \| (\d+) e-;",
    }
    found = {name: re.findall(pattern, TOUR) for name, pattern in patterns.items()}
    return {name: float(text.replace(" ", "")) for name, (text,) in found.items()}


def test_the_figures_of_the_walk_agree_with_each_other() -> None:
    """Counts and electrons are one exposure's, within the noise of the mean that stands beside."""
    told = figures_of_the_camera()
    assert abs(told["electrons"] - told["mean_e"]) < 14_000
    (row,) = re.findall(r"`chain.Chain.record` \|.* \| ([\d ]+) \|", TOUR)
    assert float(row.replace(" ", "")) == told["count"]


@pytest.mark.whole
def test_the_walks_give_what_the_tour_says() -> None:
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", TOUR, re.DOTALL):
        exec(block, names)
    assert names["delay_s"] == pytest.approx(37.602e-9, abs=1e-12)
    off = {
        "mean_e": 1000,
        "truth_e": 2,
        # Noise, by up to 4 standard deviations: processors that round otherwise draw another.
        "count": 20,
        "electrons": 14_000,
        "value": 20_000,
        "cell_e": 420,
    }
    for name, value in figures_of_the_camera().items():
        assert names[name] == pytest.approx(value, abs=off[name]), name
    assert names["score"].psnr_db == pytest.approx(37.6, abs=0.3)
    assert names["detection"].range_m == pytest.approx(5.6368, abs=2e-4)
