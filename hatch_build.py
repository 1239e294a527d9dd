"""The README of a distribution: outside the repository, what it links to lies at the project's address."""

import re
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface

_PICTURE = re.compile(r"!\[([^\]]*)\]\((?!\w+:)([^)]+)\)(\n?(?:[^\n]+\n)*)\n*")  # and what stands below it
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((?!\w+:)([^)]+)\)")


def outside(text: str, source: str | None) -> str:
    """Return a README whose pictures and links do not need the files beside it.

    Parameters
    ----------
    text : str
        The README, in Markdown, with paths relative to the project.
    source : str or None
        Address under which the project's files are, such as ``https://host/owner/name/blob/v0.2.0``; without
        one, pictures are left out and links become the names of files in the source distribution.
    """
    if source is None:
        return _LINK.sub(lambda link: f"{link[1]} (`{link[2]}`)", _PICTURE.sub("", text))
    base = source.rstrip("/")
    raw = base.replace("/blob/", "/raw/")
    text = _PICTURE.sub(lambda picture: f"![{picture[1]}]({raw}/{picture[2]}){picture[3]}\n", text)
    return _LINK.sub(lambda link: f"[{link[1]}]({base}/{link[2]})", text)


class ReadmeHook(MetadataHookInterface):
    """Puts the README into the metadata, with ``source`` of the hook's configuration as its base."""

    def update(self, metadata: dict[str, object]) -> None:
        """Set the key ``readme``."""
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        found = outside(text, self.config.get("source"))
        metadata["readme"] = {"content-type": "text/markdown", "text": found}
