"""The site builds without a warning, with its formulas, and loads nothing from elsewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site."""
    for module in ("mkdocs", "material", "mkdocstrings", "mike", "latex2mathml"):
        pytest.importorskip(module)
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    return folder


@pytest.mark.slow
def test_formulas_are_drawn(site: Path) -> None:
    markdown = (ROOT / "docs" / "safe-baselines.md").read_text()
    formulas = len(re.findall(r"\$\$.+?\$\$|\$[^$\n]+\$", markdown))
    page = (site / "safe-baselines" / "index.html").read_text()
    assert page.count("<math ") == formulas > 40
    assert "arithmatex" not in page


@pytest.mark.slow
def test_docstrings_are_rendered(site: Path) -> None:
    for page in site.glob("reference/*/index.html"):
        text = page.read_text()
        assert ":param" not in text
        assert not re.search(r":(class|func|meth|exc):", text), page


@pytest.mark.slow
def test_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    for page in site.rglob("*.html"):
        loaded = re.findall(
            r'<(?:script|img|video|link)\b[^>]*\b(?:src|href)="(https?:[^"]+)', page.read_text()
        )
        assert not loaded, (page, loaded)
