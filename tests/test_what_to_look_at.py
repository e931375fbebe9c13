"""The figures under "What to look at" on the algorithms' pages, against the recorded curves in docs/data."""

import re
from collections.abc import Callable

import pandas as pd
import pytest
from scripts import ROOT

EVALUATED, TRAINED, ENTROPY = "evaluation/return_mean", "training/return_mean", "policy/entropy"
VARIANCE, KL, CLIPPED = "value/explained_variance", "policy/approximate_kl", "policy/clip_fraction"


class Number(float):
    """A number of a text, with half a unit of its last digit that is not 0."""

    half: float

    def __new__(cls, text):
        number = super().__new__(cls, text.replace(",", ""))
        decimals = len(text.partition(".")[2])
        zeros = 0 if decimals else len(text.replace(",", "")) - len(text.replace(",", "").rstrip("0"))
        number.half = 0.5 * 10.0 ** (zeros - decimals)
        return number

    def is_about(self, value):
        """Whether the value, rounded like this number, is this number."""
        return abs(value - self) <= self.half + 1e-9


class Curves:
    """A recorded run: curves[tag] is a series over timesteps."""

    def __init__(self, name):
        table = pd.read_csv(ROOT / "docs" / "data" / f"{name}.csv")
        table["timestep"] = table["timestep"].astype(float)
        self.series = {tag: part.set_index("timestep")["value"] for tag, part in table.groupby("tag")}

    def __getitem__(self, tag):
        return self.series[tag]

    def within(self, tag, start, end=float("inf")):
        """A part of a curve; its points lie up to a few hundred steps after round numbers."""
        return self[tag].loc[start - 600.0 : end + 600.0]

    def at(self, tag, timestep):
        return self[tag].loc[: timestep + 600.0].iloc[-1]

    def first(self, tag):
        return self[tag].iloc[0]

    def last(self, tag):
        return self[tag].iloc[-1]

    def goes(self, tag, start, end):
        return start.is_about(self.first(tag)) and end.is_about(self.last(tag))


# algorithm, run, words of the page, what must be true of the curves and the words' numbers
Claim = tuple[str, str, str, Callable[..., bool]]
CLAIMS: list[Claim] = [
    (
        "ia2c",
        "healthy",
        "from 0.4 to above 0.95 within 100,000 steps",
        lambda c, a, b, t: a.is_about(c.first(EVALUATED)) and c.within(EVALUATED, 0, t).max() > b,
    ),
    ("ia2c", "healthy", "from 1.55 to 0.55", lambda c, a, b: c.goes(ENTROPY, a, b)),
    (
        "ia2c",
        "healthy",
        "begins near 0 and comes to 0.3",
        lambda c, a, b: a.is_about(c.first(VARIANCE)) and b.is_about(c.within(VARIANCE, 200_000).mean()),
    ),
    ("ia2c", "sick", "Within 20,000 steps the entropy is 0", lambda c, t, a: c.within(ENTROPY, t).max() < a + 0.001),
    (
        "ippo",
        "healthy",
        "flat for 300,000 steps, and then its return rises from 0.37 to 0.98 within 75,000",
        lambda c, t, a, b, n: (
            c.within(EVALUATED, 0, t).max() < 0.5
            and a.is_about(c.at(EVALUATED, t))
            and b.is_about(c.at(EVALUATED, t + n))
        ),
    ),
    (
        "ippo",
        "healthy",
        "`policy/approximate_kl` stays below 0.01 and `policy/clip_fraction` at 0.1 or less",
        lambda c, a, b: c[KL].max() < a and c[CLIPPED].max() <= b + b.half,
    ),
    ("ippo", "healthy", "rises all the time, from 0.45 to 0.95", lambda c, a, b: c.goes(VARIANCE, a, b)),
    ("ippo", "sick", "lies mostly between 0.1 and 6", lambda c, a, b: c[KL].between(a, b).mean() > 0.7),
    ("ippo", "sick", "falls below 0.1 within 50,000 steps", lambda c, a, t: c.within(ENTROPY, 0, t).min() < a),
    ("ippo", "sick", "mostly above 0.7", lambda c, a: (c[VARIANCE] > a).mean() > 0.7),
    (
        "maa2c",
        "healthy",
        "from 0.4 to above 0.95 within 100,000 steps",
        lambda c, a, b, t: a.is_about(c.first(EVALUATED)) and c.within(EVALUATED, 0, t).max() > b,
    ),
    ("maa2c", "healthy", "falls from 1.72 to 0.75", lambda c, a, b: c.goes(ENTROPY, a, b)),
    ("maa2c", "healthy", "from 0 to above 0.3", lambda c, a, b: c.first(VARIANCE) < 0.03 + a and c.last(VARIANCE) > b),
    ("maa2c", "healthy", "`loss/critic` falls from 7 to 2", lambda c, a, b: c.goes("loss/critic", a, b)),
    ("maa2c", "sick", "stays at 1.77", lambda c, a: c[ENTROPY].between(a - 0.02, a + 0.02).all()),
    ("maa2c", "sick", "is about -1.8", lambda c, a: abs(c["loss/actor"].mean() - a) < 0.1),
    (
        "maa2c",
        "sick",
        "from the 0.4 of random agents to 0.6",
        lambda c, a, b: a.is_about(c.first(EVALUATED)) and b.is_about(c[EVALUATED].max()),
    ),
    (
        "mappo",
        "healthy",
        "stays at its first value for 60,000 steps and then rises to above 0.95",
        lambda c, t, b: (
            c.within(EVALUATED, 0, t).max() < c.first(EVALUATED) + 0.1 and c.within(EVALUATED, 0, 2 * t).max() > b
        ),
    ),
    ("mappo", "healthy", "falls from 1.5 to 0.7", lambda c, a, b: c.goes(ENTROPY, a, b)),
    (
        "mappo",
        "healthy",
        "below 0.01\nand `policy/clip_fraction` below 0.12",
        lambda c, a, b: c[KL].max() < a and c[CLIPPED].max() < b,
    ),
    (
        "mappo",
        "healthy",
        "about\n0.3 during the flat part and rises to above 0.9",
        lambda c, a, b: abs(c.within(VARIANCE, 0, 60_000).mean() - a) < 0.05 and c.last(VARIANCE) > b,
    ),
    (
        "mappo",
        "sick",
        "`policy/approximate_kl` is 0.8 and\n`policy/clip_fraction` above 0.1",
        lambda c, a, b: a.is_about(c.first(KL)) and c.first(CLIPPED) > b,
    ),
    ("mappo", "sick", "explained variance above 0.9", lambda c, a: c.within(VARIANCE, 130_000).min() > a),
    (
        "coma",
        "healthy",
        "rises to 0.6, stays around 0.2 from 1.4 to 3 million steps, rises to 0.78 at four million, and\nfalls to 0.5",
        lambda c, a, b, t, u, d, e: (
            a.is_about(c.within(EVALUATED, 0, 1_400_000).max())
            and abs(c.within(EVALUATED, t * 1e6, u * 1e6).mean() - b) < 0.03
            and d.is_about(c.at(EVALUATED, 4_000_000))
            and e.is_about(c.last(EVALUATED))
        ),
    ),
    (
        "coma",
        "healthy",
        "falls from 1.7 to 0.4 and comes back to 0.8",
        lambda c, a, b, d: (
            a.is_about(c.first(ENTROPY))
            and b.is_about(c[ENTROPY].min())
            and d.is_about(c.within(ENTROPY, 3_500_000).max())
        ),
    ),
    (
        "coma",
        "healthy",
        "highest, above 0.8,",
        lambda c, a: c[VARIANCE].max() > a and c.at(EVALUATED, c[VARIANCE].idxmax()) < 0.3,
    ),
    ("coma", "sick", "below\n-200", lambda c, a: c.first(VARIANCE) < a),
    ("coma", "sick", "comes below 0.001", lambda c, a: c["loss/critic"].min() < a),
    ("iql", "healthy", "begins at 0.05", lambda c, a: a.is_about(c.first(EVALUATED))),
    (
        "iql",
        "healthy",
        "rises to 0.63 within 90,000 steps",
        lambda c, a, t: abs(c.within(EVALUATED, t - 10_000, t + 10_000).mean() - a) < 0.02,
    ),
    ("iql", "healthy", "comes to 0.98", lambda c, a: a.is_about(c.last(EVALUATED))),
    ("iql", "healthy", "is higher, above 0.8", lambda c, a: c.within(TRAINED, 100_000, 180_000).mean() > a),
    (
        "iql",
        "healthy",
        "falls from 0.9 to 0.3 and rises again to 0.7",
        lambda c, a, b, d: (
            a.is_about(c.first("loss/value"))
            and b.is_about(c["loss/value"].min())
            and d.is_about(c.within("loss/value", 200_000).max())
        ),
    ),
    (
        "iql",
        "sick",
        "rises to 5 within 30,000 steps",
        lambda c, a, t: a.is_about(c.within("loss/value", 0, t + t.half).max()),
    ),
    ("vdn", "healthy", "begins at 0.01", lambda c, a: a.is_about(c.first(EVALUATED))),
    (
        "vdn",
        "healthy",
        "rises to 0.43 within 90,000\nsteps",
        lambda c, a, t: a.is_about(c.within(EVALUATED, 0, t).max()),
    ),
    ("vdn", "healthy", "again, to 0.97", lambda c, a: a.is_about(c.last(EVALUATED))),
    ("vdn", "healthy", "is higher, 0.7,", lambda c, a: a.is_about(c.within(TRAINED, 80_000, 200_000).mean())),
    ("vdn", "sick", "nevertheless, to 0.5", lambda c, a: a.is_about(c.last(EVALUATED))),
    (
        "qmix",
        "healthy",
        "begins near 18 and climbs to 47",
        lambda c, a, b: a.is_about(c.first("value/mean")) and b.is_about(c["value/mean"].max()),
    ),
    (
        "qmix",
        "healthy",
        "is 1 after 500,000 steps; from 600,000 to 800,000 the return rises from 0.46 to 0.97, and it ends\nat 1",
        lambda c, a, t, u, v, b, d, e: (
            a.is_about(c.within("value/mean", 0, t + 10_000).iloc[-1])
            and b.is_about(c.at(EVALUATED, u))
            and d.is_about(c.at(EVALUATED, v))
            and e.is_about(c.last(EVALUATED))
        ),
    ),
    (
        "qmix",
        "healthy",
        "rises above 2,000 and is below 20 from 430,000 steps on",
        lambda c, a, b, t: c["gradient/norm"].max() > a and c.within("gradient/norm", t).max() < b,
    ),
    ("qmix", "healthy", "falls\nfrom 12 to 0.2", lambda c, a, b: c.goes("loss/value", a, b)),
    (
        "qmix",
        "sick",
        "of `loss/value` is 3,700 instead of 12, and that of `gradient/norm` 16,000 instead of\n100",
        lambda c, a, _, b, __: a.is_about(c.first("loss/value")) and b.is_about(c.first("gradient/norm")),
    ),
    ("qmix", "sick", "a loss near 2", lambda c, a: abs(c.within("loss/value", 100_000).mean() - a) < 0.3),
    ("qmix", "sick", "stays near 10", lambda c, a: c.within("value/mean", 50_000).between(a - 2, a + 2).all()),
    (
        "maddpg",
        "healthy",
        "from 0.39 to 0.12",
        lambda c, a, b: a.is_about(c.first(EVALUATED)) and b.is_about(c[EVALUATED].min()),
    ),
    (
        "maddpg",
        "healthy",
        "15,000 steps `policy/entropy` has fallen to 0.07",
        lambda c, t, a: t.is_about(c[ENTROPY].idxmin()) and a.is_about(c[ENTROPY].min()),
    ),
    (
        "maddpg",
        "healthy",
        "between 60,000 and 120,000 steps the\nreturn rises to 0.89",
        lambda c, t, u, a: c.at(EVALUATED, t) < 0.3 and a.is_about(c.at(EVALUATED, u)),
    ),
    (
        "maddpg",
        "healthy",
        "between 0.66 and 0.93",
        lambda c, a, b: (
            a.is_about(c.within(EVALUATED, 130_000).min()) and b.is_about(c.within(EVALUATED, 130_000).max())
        ),
    ),
    ("maddpg", "sick", "stays at 1.79", lambda c, a: c[ENTROPY].map(a.is_about).all()),
]


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: f"{claim[0]}: {' '.join(claim[2].split())}")
def test_figures_of_a_page(claim):
    algorithm, health, words, holds = claim
    page = (ROOT / "docs" / "algorithms" / f"{algorithm}.md").read_text(encoding="utf-8")
    text = page.partition("## What to look at")[2].partition("\n## ")[0]
    healthy, _, sick = text.partition("In the sick run")
    assert (sick if health == "sick" else healthy).count(words) == 1
    numbers = [Number(found) for found in re.findall(r"-?\d[\d,]*(?:\.\d+)?", words)]
    assert holds(Curves(f"{algorithm}-{health}"), *numbers)
