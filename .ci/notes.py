"""Prints the notes of a release, its section of CHANGELOG.md.

python .ci/notes.py v0.2.0
"""

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def notes(tag: str) -> str:
    """The section's text. Ends in a sentence where the tag is not the version of pyproject.toml, or has no section."""
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    if tag != f"v{version}":
        sys.exit(f"The tag is {tag}, but pyproject.toml says {version}.")
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    section = re.search(rf"^## {re.escape(version)} - \d{{4}}-\d\d-\d\d\n(.*?)(?=^## |\Z)", changelog, re.M | re.S)
    if not section:
        sys.exit(f"CHANGELOG.md has no section '## {version} - <date>'.")
    return section[1].strip()


if __name__ == "__main__":
    print(notes(sys.argv[1]))
