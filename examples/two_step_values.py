"""What VDN or QMIX has learned of the two-step game (examples/two_step.py): the team's value of each joint action.

    python algos/qmix.py --env own:examples.two_step --total-timesteps 8000 ...       docs/credit.md has all flags
    python examples/two_step_values.py qmix runs/<its directory>

prints a table for each of the three states, agent 0's actions as rows and agent 1's as columns.
"""

from envs import runs  # isort: skip (before PyTorch, as in the scripts)
import argparse
import importlib
import sys
from pathlib import Path

import torch

ROOT = Path(__file__).resolve().parents[1]
STATES = ("the first step", "game A", "game B")


def joint_values(algorithm: str, run_dir: Path) -> torch.Tensor:
    """[state, action of agent 0, of agent 1]: the sum of both agents' values, or what the mixer makes of them."""
    sys.path.append(str(ROOT / "algos"))
    module = importlib.import_module(algorithm)
    saved = runs.read_checkpoint(run_dir, algorithm)
    agents = module.load(run_dir).agents
    seen = torch.eye(3)[:, None, None].expand(-1, 1, 2, -1)  # [state, env, agent, obs]: both see which state it is
    with torch.inference_mode():
        q = agents(seen)[0]  # [state, env, agent, action]
        first, second = q[:, 0, 0, :, None], q[:, 0, 1, None, :]  # [state, action, 1], [state, 1, action]
        pairs = torch.stack(torch.broadcast_tensors(first, second), -1)  # [state, action, action, agent]
        if algorithm == "vdn":
            return pairs.sum(-1)
        mixer = module.Mixer(2, seen.shape[-1] * 2)
        mixer.load_state_dict(saved["parts"]["mixer"])
        states = seen.flatten(2).expand(-1, 4, -1)  # the observations, side by side
        return mixer(pairs.flatten(1, 2), states).view(3, 2, 2)


@runs.one_sentence(__file__)
def main() -> None:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("algorithm", choices=["vdn", "qmix"])
    parser.add_argument("run_dir", type=Path, help="of a complete run")
    args = parser.parse_args()
    for state, table in zip(STATES, joint_values(args.algorithm, args.run_dir)):
        print(f"{state}:", "   ".join(" ".join(f"{value:5.2f}" for value in row) for row in table.tolist()))


if __name__ == "__main__":
    main()
