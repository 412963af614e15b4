"""Terms of clips, where a dataset has several."""

import re
from dataclasses import dataclass

#: Licences whose holders allow what is made of their data to be passed on, as people and SPDX write them.
_SHARED = re.compile(
    r"(?:cc[ -]?0|cc[ -]by(?:[ -]nc)?(?:[ -]sa)?|creative commons (?:zero|attribution(?:[ -]noncommercial)?"
    r"(?:[ -]sharealike)?)|public domain|pddl|odc[ -]by|odbl|mit|apache[ -]?2(?:\.0)?|bsd(?:[ -][23][ -]clause)?)"
    r"(?:[ -]v?[0-9](?:\.[0-9])?)?(?: (?:international|universal|unported|licen[cs]e))*\.?",
    re.IGNORECASE,
)


@dataclass(frozen=True, order=True)
class Licence:
    """Licence and citation of some clips."""

    text: str  # "" where it is the dataset's
    citation: str = ""

    @property
    def may_share(self) -> bool:
        """Whether the data may be passed on: known licences with derivatives only, such as CC BY 4.0."""
        return _SHARED.fullmatch(self.text.strip()) is not None

    def to_json(self) -> dict[str, str | bool]:
        """Return plain JSON data."""
        return {"licence": self.text, "citation": self.citation, "may_share": self.may_share}
