"""The paper's benchmark: what runs it, collects its results, and reports them.

Programs: run, collect, report, time_stepping, time_training. Below them: plan (what is to run), campaign and cluster
(how it runs), store (the files of the results), measures (what they say in numbers), tables, plots and claims.
"""

import importlib.util
import sys

from envs import InputError
from envs.runs import one_sentence

with one_sentence(sys.argv[0]):
    for package in ("matplotlib", "pandas", "scipy"):
        if importlib.util.find_spec(package) is None:
            raise InputError(f"{package} is not installed; pip install -e '.[benchmark]' does it.")
