"""The off-policy scripts: values, losses, exploration and replay, against hand-made cases and slow, obvious loops.

What has the same text in several scripts, as test_algos_text.py demands of it, is tested in the first of them.
"""

from copy import deepcopy
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scripts import OFF_POLICY, VALUE_BASED, FakeRun, args_of, nine, own_rewards, parse, script, trained
from slow import (
    LENGTHS,
    N_ACTIONS,
    N_AGENTS,
    OBS_SIZE,
    REAL_ENDS,
    STATE_SIZE,
    assert_learnt_alike,
    make_batch,
    one_hot,
    slow_rewards,
    slow_step,
    slow_target,
    step_by_step,
)

from envs import runs

REWARDS = [(name, False) for name in nine(OFF_POLICY)] + [("iql", True), ("maddpg", True)]  # the team's, or their own
LOSSES = {
    "optimiser": "loss/value",
    "actor_optimiser": "loss/actor",
    "critic_optimiser": "loss/critic",
}  # what each lowers
NORMS = {"optimiser": "gradient/norm", "actor_optimiser": "gradient/actor_norm"}
NORMS["critic_optimiser"] = "gradient/critic_norm"


def best(values, available):
    """The available action of the largest value."""
    return max((a for a in range(N_ACTIONS) if available[a]), key=lambda a: values[a].item())


# --- updates ---
def make_parts(module, args):
    """What `update` learns with: random networks, targets that differ from them, optimisers that move nothing."""
    parts: dict = {}
    for kind in ("", "target_"):
        parts[f"{kind}agents"] = module.MultiAgentNetwork(args, N_AGENTS, OBS_SIZE, N_ACTIONS, args.network)
        if module.__name__ == "qmix":
            parts[f"{kind}mixer"] = module.Mixer(N_AGENTS, STATE_SIZE)
        if module.__name__ == "maddpg":
            parts[f"{kind}critic"] = module.MultiAgentNetwork(args, N_AGENTS, STATE_SIZE + N_AGENTS * N_ACTIONS, 1)
    learning = {part: list(parts[part].parameters()) for part in ("agents", "mixer", "critic") if part in parts}
    if module.__name__ == "maddpg":
        parts["actor_optimiser"] = torch.optim.SGD(learning["agents"], lr=0.0)
        parts["critic_optimiser"] = torch.optim.SGD(learning["critic"], lr=0.0)
    else:
        parts["optimiser"] = torch.optim.SGD([x for parameters in learning.values() for x in parameters], lr=0.0)
    return parts


def update(module, args, parts, batch, n_updates=1):
    """An update of the script; what MADDPG draws in it is that of the seed 1."""
    rng = [torch.Generator().manual_seed(1)] if module.__name__ == "maddpg" else []
    return module.update(args, parts, batch, n_updates, *rng)


def learning_parameters(parts):
    """By optimiser, the parameters that it moves."""
    return {optimiser: parts[optimiser].param_groups[0]["params"] for optimiser in LOSSES if optimiser in parts}


def make_args(module, **flags):
    """Flags for `update`: no clipping and targets that stay, unless the test says otherwise."""
    return args_of(module, **{"hidden_dim": 8, "max_grad_norm": 1e9, "target_update": "hard"} | flags)


def slow_mix(mixer, values, state):
    """The mixing network of the paper for one step: values [agent], state [state]."""
    first_weights = mixer.W1[2](torch.relu(mixer.W1[0](state))).abs()
    last_weights = mixer.w2[2](torch.relu(mixer.w2[0](state))).abs()
    mixed = mixer.b2[2](torch.relu(mixer.b2[0](state)))[0]
    first_bias = mixer.b1(state)
    for unit in range(32):
        x = first_bias[unit]
        for i, value in enumerate(values):
            x = x + value * first_weights[32 * i + unit]
        mixed = mixed + last_weights[unit] * (x if x > 0 else x.exp() - 1)
    return mixed


def slow_value_losses(name, args, parts, batch):
    """IQL, VDN, QMIX by loops over episodes, steps and agents."""
    rewards, errors, values, goals = slow_rewards(args, batch), [], [], []
    for e, length in enumerate(LENGTHS):
        online = step_by_step(parts["agents"], batch.observations[:, e])
        target = step_by_step(parts["target_agents"], batch.observations[:, e])
        for t in range(length):
            goes_on = t < length - 1 or not (REAL_ENDS[e] or args.time_limit == "terminal")
            now = [online[t][i, batch.actions[t, e, i]] for i in range(N_AGENTS)]
            chosen = [best(online[t + 1][i], batch.action_masks[t + 1, e, i]) for i in range(N_AGENTS)]
            then = [target[t + 1][i, chosen[i]] for i in range(N_AGENTS)]
            if name == "vdn":
                now, then = [sum(now)], [sum(then)]
            if name == "qmix":
                now = [slow_mix(parts["mixer"], now, batch.states[t, e])]
                then = [slow_mix(parts["target_mixer"], then, batch.states[t + 1, e])]
            for i, (value, next_value) in enumerate(zip(now, then)):
                goal = rewards[t, e, i] + goes_on * args.gamma * next_value.detach()
                errors.append((goal - value) ** 2)
                values.append(value)
                goals.append(goal)
    means = {"loss/value": errors, "value/mean": values, "value/target_mean": goals}
    return {name: torch.stack(figures).mean() for name, figures in means.items()}


def slow_maddpg_losses(args, parts, batch, noise):
    """MADDPG by loops over episodes, steps and agents. noise [time, env, agent, action]: added to the logits."""

    def judged(critic, i, state, actions):
        """What critic i says of a state and a list of all agents' actions."""
        return critic(torch.cat([state, *actions]).expand(1, 1, N_AGENTS, -1))[0][0, 0, i, 0]

    rewards, critic_errors, actor_terms = slow_rewards(args, batch), [], []
    for e, length in enumerate(LENGTHS):
        logits = step_by_step(parts["agents"], batch.observations[:, e])
        target_logits = step_by_step(parts["target_agents"], batch.observations[:, e])
        for t in range(length):
            goes_on = t < length - 1 or not (REAL_ENDS[e] or args.time_limit == "terminal")
            masks, next_masks = batch.action_masks[t, e], batch.action_masks[t + 1, e]
            taken = [one_hot(batch.actions[t, e, i]) for i in range(N_AGENTS)]
            greedy = [one_hot(best(target_logits[t + 1][i], next_masks[i])) for i in range(N_AGENTS)]
            drawn = []
            for i in range(N_AGENTS):
                noisy = logits[t][i] + noise[t, e, i]
                soft = torch.zeros(N_ACTIONS).masked_scatter(masks[i], noisy[masks[i]].softmax(-1))
                drawn.append(one_hot(best(noisy, masks[i])) + soft - soft.detach())
            for i in range(N_AGENTS):
                goal = rewards[t, e, i]
                if goes_on:
                    goal = (
                        goal + args.gamma * judged(parts["target_critic"], i, batch.states[t + 1, e], greedy).detach()
                    )
                critic_errors.append((goal - judged(parts["critic"], i, batch.states[t, e], taken)) ** 2)
                actions = [drawn[j] if j == i else drawn[j].detach() for j in range(N_AGENTS)]
                gain = judged(parts["critic"], i, batch.states[t, e], actions)
                squares = sum(logits[t][i][a] ** 2 for a in range(N_ACTIONS) if masks[i][a])  # 0 where masked
                actor_terms.append(args.actor_regularisation * squares / N_ACTIONS - gain)
    return {"loss/critic": torch.stack(critic_errors).mean(), "loss/actor": torch.stack(actor_terms).mean()}


@pytest.mark.parametrize("name, individual", REWARDS)
@pytest.mark.parametrize("time_limit", ["bootstrap", "terminal"])
@pytest.mark.parametrize("sharing, network, standardisation", [(True, "fc", False), (False, "gru", True)])
@pytest.mark.slow
def test_losses_of_the_first_update(name, individual, time_limit, sharing, network, standardisation):
    """Losses and gradients against the slow ones."""
    module = script(name)
    flags = {"time_limit": time_limit, "parameter_sharing": sharing}
    if individual:
        flags["individual_rewards"] = True
    if name == "maddpg":
        flags["actor_regularisation"] = 0.1
    args = make_args(module, network=network, reward_standardisation=standardisation, **flags)
    torch.manual_seed(0)
    parts, batch = make_parts(module, args), make_batch(args)
    if name == "maddpg":
        torch.manual_seed(1)
        noise = -torch.empty(*batch.actions.shape, N_ACTIONS).exponential_().log()
        expected = slow_maddpg_losses(args, parts, batch, noise)
    else:
        expected = slow_value_losses(name, args, parts, batch)
    learning = learning_parameters(parts)
    gradients = {x: torch.autograd.grad(expected[LOSSES[x]], learning[x]) for x in learning}
    figures = update(module, args, parts, batch)
    for name, figure in expected.items():
        torch.testing.assert_close(figures[name], figure, rtol=1e-4, atol=1e-6)
    for optimiser, parameters in learning.items():
        for parameter, gradient in zip(parameters, gradients[optimiser]):
            torch.testing.assert_close(parameter.grad, gradient, rtol=1e-3, atol=1e-5)
        norm = torch.cat([gradient.flatten() for gradient in gradients[optimiser]]).norm()
        torch.testing.assert_close(figures[NORMS[optimiser]], norm, rtol=1e-3, atol=1e-5)


def slow_update(name, args, parts, batch):
    """An update by the slow losses; the critic of MADDPG first. Returns the norms of the gradients before clipping."""
    norms = []
    for optimiser in reversed(learning_parameters(parts)):
        torch.manual_seed(1)
        if name == "maddpg":
            noise = -torch.empty(*batch.actions.shape, N_ACTIONS).exponential_().log()
            losses = slow_maddpg_losses(args, parts, batch, noise)
        else:
            losses = slow_value_losses(name, args, parts, batch)
        norms.append(slow_step(parts[optimiser], losses[LOSSES[optimiser]], args.max_grad_norm))
    for part in {"agents", "mixer", "critic"} & parts.keys():
        slow_target(parts[f"target_{part}"], parts[part])
    return norms


@pytest.mark.parametrize("name", nine(OFF_POLICY))
@pytest.mark.slow
def test_updates_in_a_row(name):
    """Adam, clipping and soft targets with the losses: a mistake in what one update leaves to the next shows here."""
    module = script(name)
    args = make_args(module, network="gru", reward_standardisation=True, target_update="soft")
    torch.manual_seed(0)
    parts = make_parts(module, args)
    for optimiser, parameters in learning_parameters(parts).items():
        parts[optimiser] = torch.optim.Adam(parameters, lr=0.01, fused=True)
    slow, start, batch, norms = deepcopy(parts), deepcopy(parts), make_batch(args), []
    args.max_grad_norm = 0.95 * max(slow_update(name, args, deepcopy(parts), batch))
    for updates in range(1, 6):
        norms += slow_update(name, args, slow, batch)
        update(module, args, parts, batch, updates)
    assert min(norms) < args.max_grad_norm < max(norms)  # some were clipped
    assert_learnt_alike(parts, slow, start)


@pytest.mark.parametrize("name", nine(OFF_POLICY))
@pytest.mark.parametrize("network", ["fc", "gru"])
@pytest.mark.parametrize("standardisation", [False, True])
def test_what_was_not_played_is_never_learnt_from(name, network, standardisation):
    """Rows after an end are empty or hold what an older episode left there, with no action available or with all."""
    module = script(name)
    args = make_args(module, network=network, reward_standardisation=standardisation, time_limit="bootstrap")
    torch.manual_seed(0)
    parts, results = make_parts(module, args), []
    for garbage in (False, True):
        losses = update(module, args, parts, make_batch(args, garbage))
        gradients = [x.grad.clone() for parameters in learning_parameters(parts).values() for x in parameters]
        results.append([*losses.values(), *gradients])
    for empty, full in zip(*results):
        assert torch.isfinite(empty).all()
        torch.testing.assert_close(full, empty)


@pytest.mark.parametrize("name", nine(OFF_POLICY))
@pytest.mark.parametrize("method", ["hard", "soft"])
def test_targets_follow(name, method):
    """All targets are copied at update 200 and not at 199, or move by one hundredth of the way at each update."""
    module = script(name)
    args = make_args(module, target_update=method)
    torch.manual_seed(0)
    parts = make_parts(module, args)
    pairs = [(parts[part], parts[f"target_{part}"]) for part in ("agents", "mixer", "critic") if part in parts]
    assert len(pairs) == (2 if name in ("qmix", "maddpg") else 1)
    for updates, share in ((199, 0.0), (200, 1.0)) if method == "hard" else ((1, 0.01), (2, 0.01)):
        before = [[x.clone() for x in target.parameters()] for _, target in pairs]
        update(module, args, parts, make_batch(args), updates)
        for (online, target), old in zip(pairs, before):
            for new, x, then in zip(online.parameters(), target.parameters(), old):
                torch.testing.assert_close(x, (1 - share) * then + share * new)


class TestMixer:
    def test_against_the_formula(self):
        torch.manual_seed(0)
        mixer = script("qmix").Mixer(N_AGENTS, STATE_SIZE)
        values, states = 3 * torch.randn(4, 5, N_AGENTS), torch.randn(4, 5, STATE_SIZE)
        mixed = mixer(values, states)
        for t, e in np.ndindex(4, 5):
            torch.testing.assert_close(
                mixed[t, e, 0], slow_mix(mixer, values[t, e], states[t, e]), rtol=1e-4, atol=1e-5
            )

    @pytest.mark.parametrize("hidden_dim", [16, 100])
    def test_sizes_do_not_depend_on_the_hidden_dimension(self, monkeypatch, hidden_dim):
        run = trained(monkeypatch, "qmix", 0, hidden_dim=hidden_dim)
        n, state = run.env.n_agents, run.env.state_size
        layers = [x for x in run.parts["mixer"].modules() if isinstance(x, torch.nn.Linear)]
        expected = [(state, 64), (64, 32 * n), (state, 32), (state, 64), (64, 32), (state, 32), (32, 1)]
        assert sorted((x.in_features, x.out_features) for x in layers) == sorted(expected)
        assert all(x.bias is not None for x in layers)


# --- exploration ---
class TestEpsilon:
    def team(self, epsilon):
        module = script(nine(VALUE_BASED)[0])
        args = args_of(module, hidden_dim=8, eval_epsilon=epsilon)
        torch.manual_seed(0)
        agents = module.MultiAgentNetwork(args, 2, OBS_SIZE, N_ACTIONS)
        return module.Team(args, agents, torch.Generator().manual_seed(0))

    def test_frequencies(self):
        """Of all pairs of actions, in many copies of one situation where the best action of all is not available."""
        n, epsilon = 40_000, 0.4
        team = self.team(epsilon)
        observation = np.random.default_rng(0).normal(size=(1, 2, OBS_SIZE)).astype(np.float32)
        values = team.agents(torch.from_numpy(observation)[None])[0][0, 0].detach()
        masks = np.ones((2, N_ACTIONS), bool)
        masks[[0, 1], values.argmax(-1)] = False
        masks[1, values[1].argmin()] = False
        actions = team.act(observation.repeat(n, 0), {"action_mask": masks[None].repeat(n, 0)})
        probabilities = np.where(masks, epsilon / masks.sum(-1, keepdims=True), 0.0)
        for i in range(2):
            probabilities[i, best(values[i], masks[i])] += 1 - epsilon
        expected = np.outer(*probabilities)  # each agent explores by itself
        frequencies = np.bincount(N_ACTIONS * actions[:, 0] + actions[:, 1], minlength=N_ACTIONS**2) / n
        assert probabilities.sum(-1) == pytest.approx(1.0) and (frequencies[expected.ravel() == 0] == 0).all()
        # five standard errors
        assert (np.abs(frequencies - expected.ravel()) <= 5 * np.sqrt(expected * (1 - expected) / n).ravel()).all()

    @pytest.mark.parametrize("name", nine(VALUE_BASED))
    def test_schedule(self, monkeypatch, name):
        """From 1 to 0.05 in 100 steps, four episodes of a matrix game; in evaluations the evaluations' own."""
        module, seen = script(name), []
        collect = module.collect

        def noted(args, env, team, batch):
            seen.append(team.epsilon)
            return collect(args, env, team, batch)

        monkeypatch.setattr(module, "collect", noted)
        run = trained(monkeypatch, name, 7, "matrix-climbing", epsilon_anneal=100, eval_epsilon=0.03)
        assert seen == pytest.approx([1.0, 0.7625, 0.525, 0.2875, 0.05, 0.05, 0.05])
        assert module.Team(run.args, run.parts["agents"], run.rng).epsilon == 0.03


# --- replay ---
class Game:
    """One environment that plays random numbers, one episode after another, and notes what it showed.

    Episode k, counted from 1, pays the team k at each step. Its length and its end are those of LENGTHS and REAL_ENDS.
    """

    num_envs, n_agents, n_actions, obs_size = 1, N_AGENTS, N_ACTIONS, OBS_SIZE

    def __init__(self, state_is_observations, episode):
        self.state_is_observations, self.episode, self.episode_limit = state_is_observations, episode, max(LENGTHS)
        self.state_size = N_AGENTS * OBS_SIZE if state_is_observations else STATE_SIZE
        self.rng, self.notes = np.random.default_rng(0), {}

    def show(self):
        observations = self.rng.normal(size=(1, N_AGENTS, OBS_SIZE)).astype(np.float32)
        state = self.rng.normal(size=(1, STATE_SIZE)).astype(np.float32)
        masks = self.rng.random((1, N_AGENTS, N_ACTIONS)) < 0.5
        masks[..., self.rng.integers(N_ACTIONS)] = True
        notes = self.notes[self.episode]
        notes.states.append(observations.reshape(1, -1) if self.state_is_observations else state)
        notes.observations.append(observations)
        notes.action_masks.append(masks)
        rewards = self.episode + np.arange(N_AGENTS, dtype=np.float32)[None] / 4
        return observations, {"state": notes.states[-1], "action_mask": masks, "agent_rewards": rewards}

    def reset(self):
        self.episode += 1
        self.notes[self.episode] = SimpleNamespace(observations=[], states=[], action_masks=[], actions=[])
        return self.show()

    def step(self, actions):
        self.notes[self.episode].actions.append(actions.copy())
        observations, info = self.show()
        ended = len(self.notes[self.episode].actions) == LENGTHS[self.episode % len(LENGTHS)]
        real_end = REAL_ENDS[self.episode % len(LENGTHS)]
        flags = np.array([ended and real_end]), np.array([ended and not real_end])
        return observations, np.array([self.episode], np.float32), *flags, info


class TestReplay:
    """Replays of five episodes in nine slots, so that a slot sees episodes of all lengths."""

    def begin(self, path, episode=0, state_is_observations=False, episode_limit=6, **flags):
        """A replay, its game and a function that plays some episodes into it."""
        module = script(nine(OFF_POLICY)[0])
        args = args_of(module, **{"hidden_dim": 8, "batch_size": 2, "buffer_size": 5} | flags)
        game = Game(state_is_observations, episode)
        game.episode_limit = episode_limit
        agents = module.MultiAgentNetwork(args, N_AGENTS, OBS_SIZE, N_ACTIONS)
        team = module.Team(args, agents, torch.Generator())
        arrays = module.new_storage(args, game)
        run = FakeRun(0)
        run.env, run.path = game, path
        replay = module.Replay(args, game, arrays, run)

        def play(episodes):
            for _ in range(episodes):
                replay.add(module.collect(args, game, team, arrays)[0])

        return replay, game, play

    @pytest.mark.parametrize("episodes", [3, 5, 20])
    def test_the_last_episodes_are_drawn_equally_often(self, episodes, tmp_path):
        """A batch never holds an episode twice, and is as long as its longest."""
        replay, _, play = self.begin(tmp_path)
        play(episodes)
        rng, draws = torch.Generator().manual_seed(0), 500
        counts = np.zeros(episodes + 1)
        for _ in range(draws):
            batch = replay.sample(rng)
            drawn = batch.rewards[0, :, 0].int().tolist()
            assert len(drawn) == len(set(drawn)) == 2
            assert len(batch.actions) == max(LENGTHS[k % len(LENGTHS)] for k in drawn)
            counts[drawn] += 1
        kept = min(episodes, 5)
        share = 2 / kept
        assert (counts[:-kept] == 0).all()
        assert (np.abs(counts[-kept:] / draws - share) <= 5 * np.sqrt(share * (1 - share) / draws)).all()

    @pytest.mark.parametrize("state_is_observations, time_limit", [(False, "bootstrap"), (True, "terminal")])
    @pytest.mark.parametrize("individual", [False, True])
    def test_a_batch_holds_what_was_played(self, state_is_observations, time_limit, individual, tmp_path):
        flags = {"state_is_observations": state_is_observations, "time_limit": time_limit}
        replay, game, play = self.begin(tmp_path, individual_rewards=individual, batch_size=5, **flags)
        assert ("states" in replay.file.slots.dtype.names) == (not state_is_observations)
        rng = torch.Generator().manual_seed(0)
        play(4)
        for _ in range(20):  # each slot more than twice
            play(1)
            batch = replay.sample(rng)
            for e, k in enumerate(batch.rewards[0, :, 0].int().tolist()):
                length, notes = LENGTHS[k % len(LENGTHS)], game.notes[k]
                for rows in ("observations", "states", "action_masks"):
                    np.testing.assert_array_equal(getattr(batch, rows)[: length + 1, [e]], vars(notes)[rows])
                    assert len(getattr(batch, rows)) == len(batch.actions) + 1
                np.testing.assert_array_equal(batch.actions[:length, [e]], notes.actions)
                assert (batch.rewards[:length, e] == k + torch.arange(N_AGENTS if individual else 1) / 4).all()
                assert batch.played[:, e].tolist() == [t < length for t in range(len(batch.actions))]
                ends = REAL_ENDS[k % len(LENGTHS)] or time_limit == "terminal"
                assert batch.no_bootstrap[:length, e].tolist() == [False] * (length - 1) + [ends]

    def test_number_of_episodes(self, tmp_path):
        for limit, buffer_size, batch_size, size in (
            (50, 5000, 32, 5000),
            (500, 5000, 32, 2000),
            (300, 5000, 32, 3333),
            (50, 7, 7, 7),
            (50, 7, 8, 8),
            (500, 3000, 2500, 2500),
        ):
            flags = {"episode_limit": limit, "buffer_size": buffer_size, "batch_size": batch_size}
            assert self.begin(tmp_path, **flags)[0].size == size

    def test_a_checkpoint_finds_its_episodes_again(self, tmp_path):
        """Up to two checkpoints later, a replay opened where the checkpoint was made draws what it would have drawn."""
        replay, game, play = self.begin(tmp_path, batch_size=5)
        play(13)
        replay.file.flush()
        expected = replay.sample(torch.Generator().manual_seed(0))
        for later in range(2 * replay.file.checkpoint_every + 1):
            again, _, _ = self.begin(tmp_path, batch_size=5, episode=13)
            batch = again.sample(torch.Generator().manual_seed(0))
            for array, rows in expected._asdict().items():
                assert torch.equal(getattr(batch, array), rows), (later, array)
            play(1)
        assert game.episode == 13 + 2 * replay.file.checkpoint_every + 1

    def test_a_run_from_the_start_keeps_nothing(self, tmp_path):
        replay, _, play = self.begin(tmp_path)
        play(9)
        assert replay.file.slots["played"].any(1).all()
        again, _, _ = self.begin(tmp_path)
        assert not again.file.slots["played"].any()


# --- training ---
@pytest.mark.parametrize("name", nine(OFF_POLICY))
def test_updates_and_checkpoints_of_a_run(monkeypatch, tmp_path, name):
    """One update an episode from the first full batch on, numbered from 1; a checkpoint each quarter of the replay."""
    module, numbers, saves = script(name), [], []
    learn = module.update

    def noted(args, parts, batch, n_updates, *rng):
        numbers.append(n_updates)
        assert batch.played.shape == (25, 4)  # steps of a matrix game; episodes
        return learn(args, parts, batch, n_updates, *rng)

    def noted_save(run):
        saves.append(run.env.episode)

    monkeypatch.setattr(module, "update", noted)
    monkeypatch.setattr(runs.Run, "save", noted_save)
    flags: list = ["--env", "matrix-climbing", "--batch-size", 4, "--buffer-size", 11, "--hidden-dim", 8]
    flags += ["--total-timesteps", 9 * 25, "--eval-points", 1, "--eval-episodes", 1, "--run-dir", tmp_path / "run"]
    no_signals = SimpleNamespace(received=None, keep=lambda: None, give_back=lambda: None)
    monkeypatch.setattr(runs.run, "StopSignals", lambda: no_signals)
    module.train(parse(name, flags))
    assert numbers == [1, 2, 3, 4, 5, 6]
    assert saves == [0, 3, 6, 9, 9]  # the first evaluation, and the end


@pytest.mark.parametrize("name, individual", REWARDS)
@pytest.mark.parametrize("sharing", [True, False])
@pytest.mark.parametrize("network", ["fc", "gru"])
def test_every_parameter_learns(monkeypatch, name, individual, sharing, network):
    """After one update every parameter, of each agent's own networks too, has a gradient and has moved."""
    flags = {"parameter_sharing": sharing, "network": network, "hidden_dim": 16, **own_rewards(individual)}
    if name == "maddpg":
        flags["actor_regularisation"] = 0.0  # actors learn from the critic
    start = trained(monkeypatch, name, 1, batch_size=2, reward_standardisation=True, **flags)
    run = trained(monkeypatch, name, 2, batch_size=2, reward_standardisation=True, **flags)
    assert (start.n_updates, run.n_updates) == (0, 1)
    learners = ["agents"] + [part for part in ("mixer", "critic") if part in run.parts]
    assert len(learners) == (2 if name in ("qmix", "maddpg") else 1)
    for part in learners:
        n_networks = 1 if sharing or part == "mixer" else run.env.n_agents
        assert part == "mixer" or len(run.parts[part].networks) == n_networks
        before = dict(start.parts[part].named_parameters())
        for parameter_name, parameter in run.parts[part].named_parameters():
            where = (part, parameter_name)
            assert parameter.grad is not None and parameter.grad.abs().max() > 0, where
            assert not torch.equal(parameter, before[parameter_name]), where
        assert all(parameter.grad is None for parameter in run.parts[f"target_{part}"].parameters())


# --- MADDPG ---
class FixedPolicies(torch.nn.Module):
    """Agents whose logits [agent, action] do not depend on what they see."""

    def __init__(self, logits):
        super().__init__()
        self.logits = torch.nn.Parameter(logits)

    def forward(self, observations):
        return self.logits.expand(*observations.shape[:2], -1, -1), None


class LinearCritics(torch.nn.Module):
    """Critics that weigh the actions alone: weights [critic, agent, action]"""

    def __init__(self, weights):
        super().__init__()
        self.weights = torch.nn.Parameter(weights)

    def forward(self, inputs):
        actions = inputs[..., -self.weights[0].numel() :]
        return (actions * self.weights.flatten(1)).sum(-1, keepdim=True), None


class TestMaddpg:
    def test_what_the_critics_see(self):
        """The state, then the actions of agent 0, of agent 1; one row for each critic."""
        states = torch.tensor([[[7.0, 8.0]]])  # [time 1, env 1, state 2]
        for_all = torch.tensor([[[[[1, 0, 0], [0, 0, 1]]]]])  # [time 1, env 1, 1, agent 2, action 3]
        assert script("maddpg").with_joint_actions(states, for_all).tolist() == [[[[7, 8, 1, 0, 0, 0, 0, 1]]]]
        for_each = torch.tensor([[[[[1, 0, 0], [0, 0, 1]], [[0, 1, 0], [0, 2, 3]]]]])
        rows = [[7, 8, 1, 0, 0, 0, 0, 1], [7, 8, 0, 1, 0, 0, 2, 3]]
        assert script("maddpg").with_joint_actions(states, for_each).tolist() == [[rows]]

    def actor_update(self, logits, weights, masks, regularisation):
        """The actors' loss and gradient [agent, action] in four steps, and what Gumbel added [step, agent, action]."""
        module, steps = script("maddpg"), 4
        args = args_of(module, max_grad_norm=1e9, actor_regularisation=regularisation)
        n_agents, n_actions = logits.shape
        agents, critic = FixedPolicies(logits), LinearCritics(weights)
        parts: dict = {"agents": agents, "critic": critic}
        parts |= {"target_agents": FixedPolicies(logits), "target_critic": LinearCritics(weights)}
        parts["actor_optimiser"] = torch.optim.SGD(agents.parameters(), lr=0.0)
        parts["critic_optimiser"] = torch.optim.SGD(critic.parameters(), lr=0.0)
        batch = module.Batch(
            observations=torch.zeros(steps + 1, 1, n_agents, 1),
            states=torch.zeros(steps + 1, 1, 1),
            action_masks=masks.expand(steps + 1, 1, -1, -1),
            actions=torch.zeros(steps, 1, n_agents, dtype=torch.int64),
            rewards=torch.zeros(steps, 1, 1),
            played=torch.ones(steps, 1, dtype=torch.bool),
            no_bootstrap=torch.zeros(steps, 1, dtype=torch.bool),
        )
        torch.manual_seed(0)
        noise = -torch.empty(steps, n_agents, n_actions).exponential_().log()
        loss = module.update(args, parts, batch, 1, torch.Generator().manual_seed(0))["loss/actor"].item()
        return loss, agents.logits.grad, noise

    def test_actions_are_one_hots_with_the_gradient_of_the_softmax(self):
        """Critic 0 pays 1, -2 and 64 for agent 0's actions, the last of which is not available; critic 1 nothing."""
        weights = torch.zeros(2, 2, 3)
        weights[0, 0] = torch.tensor([1.0, -2.0, 64.0])
        masks = torch.tensor([[True, True, False], [True, True, True]])
        logits = torch.tensor([[0.5, -1.0, 2.0], [0.0, 0.0, 0.0]])
        loss, gradient, noise = self.actor_update(logits, weights, masks, 0.1)
        expected_loss, expected = 0.0, torch.zeros(2, 3)
        for step in range(4):
            first, second = 0.5 + float(noise[step, 0, 0]), -1.0 + float(noise[step, 0, 1])
            p = 1 / (1 + np.exp(second - first))  # of the first of two actions
            expected_loss -= 1.0 if first > second else -2.0
            expected[0] -= torch.tensor([p * (1 - p) * 3, -p * (1 - p) * 3, 0.0])  # 3: what the first pays more
            expected_loss += 0.1 * (0.25 + 1.0 + 0.0) / 3  # of all three actions; the masked logit counts as zero
            expected[0] += 0.1 * torch.tensor([2 * 0.5, 2 * -1.0, 0.0]) / 3
        assert loss == pytest.approx(expected_loss / (4 * 2), rel=1e-5)  # the mean over steps and agents
        torch.testing.assert_close(gradient, expected / (4 * 2))

    def test_nobody_learns_from_the_critic_of_another(self):
        """Each critic looks at the other agent's actions alone."""
        weights = torch.zeros(2, 2, 3)
        weights[0, 1], weights[1, 0] = torch.tensor([1.0, -2.0, 4.0]), torch.tensor([3.0, 5.0, -7.0])
        loss, gradient, _ = self.actor_update(torch.zeros(2, 3), weights, torch.ones(2, 3, dtype=torch.bool), 0.0)
        assert loss != 0 and (gradient == 0).all()
