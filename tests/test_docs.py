"""The documentation as a whole: what its readers were promised of it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from bstm_daemon.model.effects.catalogue import effect_names

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("**/*.md"))
GUIDES = (
    *("tutorial", "how-to", "identify", "matching", "signal-quality", "gap"),
    *("python", "live", "observing"),
)
"""Pages for users; what was tested is on the pages of evidence."""

MOST_WORDS = 45_000
MOST_CHARACTERS = 100
MEAN_WORDS = 20.0

FENCE = re.compile(r"^ *```.*?^ *```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
STALE = re.compile(
    r"not yet|later version|in future|will be added", re.IGNORECASE
)


@cache
def text_of(page: Path) -> str:
    """Return a page without its code, which has rules of its own."""
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def words_of(text: str) -> list[str]:
    """Return what has a letter or digit: bars and rules are no words."""
    return [word for word in text.split() if re.search(r"[^\W_]", word)]


def sentences_of(page: Path) -> list[int]:
    """Return the words in each sentence of the running text of *page*."""
    blocks: list[str] = []
    for block in re.split(r"\n\s*\n|\n(?= *(?:[-*]|\d+\.) )", text_of(page)):
        lines = [
            line
            for line in block.splitlines()
            if not line.startswith(("|", "#", "    ", "<!--"))
        ]
        blocks.append(" ".join(lines))
    ends = re.compile(r"(?<=[.?!])[)*`\"]*\s+")
    return [
        count
        for block in blocks
        for part in ends.split(block)
        if (count := len(words_of(part))) > 2
    ]


def anchors_of(page: Path) -> set[str]:
    """Return the anchors of the headings of *page*."""
    headings = re.findall(r"^#+ (.+)$", text_of(page), re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", one.lower()).strip().replace(" ", "-")
        for one in headings
    }


def test_all_of_it_can_be_read() -> None:
    """Words as ``cat docs/*.md | wc -w`` counts them."""
    counts = {
        page.name: len(page.read_text("utf-8").split()) for page in PAGES
    }

    assert sum(counts.values()) <= MOST_WORDS, counts


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_no_line_is_longer_than_a_screen(page: Path) -> None:
    long = [
        line
        for line in text_of(page).splitlines()
        if len(line) > MOST_CHARACTERS
        and not line.startswith("|")
        and not re.fullmatch(r"\S*\[[^\]]*\]\([^)]*\)\S*", line.strip())
    ]

    assert long == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_sentences_are_short(page: Path) -> None:
    counts = sentences_of(page)

    assert sum(counts) <= MEAN_WORDS * len(counts)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_nothing_is_promised(page: Path) -> None:
    """The documents say what is."""
    assert STALE.findall(text_of(page)) == []


@pytest.mark.parametrize("name", GUIDES)
def test_guides_name_no_tests(name: str) -> None:
    text = (DOCS / f"{name}.md").read_text(encoding="utf-8")

    assert re.findall(r"tests/(?!benchmarks|rig)[\w/]+|\btest_\w+", text) == []


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=str)
def test_links_lead_somewhere(page: Path) -> None:
    wrong = []
    for target in LINK.findall(text_of(page)):
        if re.match(r"\w+://", target):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        if not file.exists() or (anchor and anchor not in anchors_of(file)):
            wrong.append(target)

    assert wrong == []


def test_index_and_site_have_every_page() -> None:
    index = (DOCS / "README.md").read_text(encoding="utf-8")
    site = (DOCS / "site" / "mkdocs.yml").read_text(encoding="utf-8")

    for page in PAGES:
        if page.name != "README.md":
            assert f"({page.name})" in index
        assert f": {page.name}\n" in site


def test_every_page_says_what_it_is_for() -> None:
    """In its first paragraph, below the title."""
    for page in PAGES:
        title, *rest = page.read_text(encoding="utf-8").split("\n\n")
        assert title.startswith("# "), page
        assert len(words_of(rest[0])) > 8, page


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs")
    done = subprocess.run(
        [
            *(sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet"),
            *("-f", DOCS / "site" / "mkdocs.yml", "-d", tmp_path / "site"),
        ],
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    for page in PAGES:
        name = "index" if page.name == "README.md" else page.stem
        assert (tmp_path / "site" / f"{name}.html").exists()


@pytest.mark.full
@pytest.mark.slow
def test_the_tutorial_runs(tmp_path: Path) -> None:
    """Its wrong disc is seen, and the sound one is not."""
    for folder in ("config", "dbc"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    page = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```sh\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    outputs = []
    for block in blocks:
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", block],
            cwd=tmp_path,
            env=os.environ | {"PATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, (block, done.stderr)
        outputs.append(done.stdout)

    assert (tmp_path / "practice.html").exists()
    good, heavy = (
        float(found[1])
        for found in re.finditer(r"FR +disc +([\d.]+)", outputs[-1])
        if float(found[1]) < 100.0
    )
    assert (round(good), round(heavy)) == (17, 33)


def test_the_readme_counts_the_catalogue() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    count = len(effect_names())

    assert f"effect among {count}, with" in readme
    assert f"a catalogue of {count}, from" in readme
