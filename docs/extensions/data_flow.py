"""A picture of an algorithm, drawn from what its page says of it: who sees what in training, and who in play."""

from typing import NamedTuple

INPUTS = {
    "the agent's observation": ["oᵢ"],
    "the state": ["s"],
    "the state and the others' actions": ["s", "a₋ᵢ"],
    "the state and all actions": ["s", "a"],
}
MIXED = {"": "its own target", "a sum": "sum of all Qᵢ", "a mixing network": "mix of all Qᵢ"}
ARROW = (
    '<marker id="arrow-{name}" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" '
    'orient="auto"><path d="M0 0L8 4L0 8z"/></marker>'
)


class Facts(NamedTuple):
    """Where an algorithm stands, as the front matter of its page says.

    replay: whether it learns from old episodes. critic: what its critic sees beside one agent's own number, one of
    INPUTS, or "". mixed: how the agents' values become one, one of MIXED. epochs: whether several gradient steps are
    made on one batch.
    """

    replay: bool = False
    critic: str = ""
    mixed: str = ""
    epochs: bool = False


def box(x: int, y: int, width: int, text: str, kind: str) -> str:
    """A box with text; x, y: the middle of its left side."""
    return (
        f'<rect class="{kind}" x="{x}" y="{y - 14}" width="{width}" height="28" rx="5"/>'
        f'<text x="{x + width / 2}" y="{y + 5}">{text}</text>'
    )


def picture(name: str, own: Facts) -> str:
    """The picture as SVG; site.css colours it."""
    if own.critic:
        inputs, above = INPUTS[own.critic], "critic Qᵢ" if "action" in own.critic else "critic Vᵢ"
        actor, down = "policy πᵢ", "gradient" if own.replay else "advantage"
    else:
        inputs, above = ["s"] if own.mixed == "a mixing network" else [], MIXED[own.mixed]
        actor, down = "values Qᵢ", "error"

    def arrow(path: str) -> str:
        return f'<path class="arrow" d="{path}" marker-end="url(#arrow-{name})"/>'

    parts = ['<rect class="training" x="4" y="24" width="332" height="62" rx="8"/>']
    parts.append('<text class="small start" x="8" y="16">in training only</text>')
    parts.append(f'<text class="small end" x="332" y="16">{"old episodes" if own.replay else "new episodes"}</text>')
    for k, text in enumerate(inputs):
        parts += [box(14 + 44 * k, 56, 38, text, "input")]
    parts += [arrow(f"M{14 + 44 * len(inputs)} 56H118")] if inputs else []
    parts += [box(122, 56, 116, above, "central" if inputs != ["oᵢ"] and (inputs or own.mixed) else "own")]
    parts += [arrow("M180 72V116"), f'<text class="small start" x="188" y="104">{down}</text>']
    parts += [box(14, 132, 38, "oᵢ", "input"), arrow("M54 132H118"), box(122, 132, 116, actor, "own")]
    parts += [arrow("M240 132H290"), box(294, 132, 38, "aᵢ", "input")]
    parts.append('<text class="small start" x="8" y="168">in play: agent i alone</text>')
    sees = f"in training its critic sees {own.critic}" if own.critic else f"in training: {above}"
    return (
        f'<figure class="flow"><figcaption>{name.upper()}</figcaption><svg viewBox="0 0 340 176" role="img">'
        f"<title>{name.upper()}: {sees}; in play agent i chooses by its own observation</title>"
        f"<defs>{ARROW.format(name=name)}</defs>{''.join(parts)}</svg></figure>"
    )
