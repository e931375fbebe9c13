"""The maths of the scripts, against cases computed by hand or by slow, obvious loops."""

import math

import numpy as np
import pytest
import torch
from scripts import NAMES, NINE, ON_POLICY, args_of, envs, nine, own_rewards, script, trained

GAMMA = 0.5


def shared(name):
    """A function or class, from the first script that has it. Its text is the same in the others (test_algos_text)."""
    return next(getattr(script(each), name) for each in NINE if hasattr(script(each), name))


def column(values, dtype=torch.float32):
    """[time] -> [time, env 1, agent 1]"""
    return torch.tensor(values, dtype=dtype).reshape(-1, 1, 1)


def flags(values):
    """[time] -> [time, env 1] bool"""
    return torch.tensor(values, dtype=torch.bool).reshape(-1, 1)


class TestReturns:
    """n_step_returns; rewards 1, 2, 4, 8 and values 10, 20, 30, 40, 50, discount one half."""

    rewards, values = column([1.0, 2.0, 4.0, 8.0]), column([10.0, 20.0, 30.0, 40.0, 50.0])

    def returns(self, played, no_bootstrap, n):
        result = shared("n_step_returns")(self.rewards, self.values, flags(played), flags(no_bootstrap), GAMMA, n)
        return result.flatten().tolist()

    def test_padding_is_never_read(self):
        """Two steps were played. What follows the state after them does not matter, after a time-out or a real end."""
        for no_bootstrap, expected in (([0, 0, 0, 0], [1 + 1 + 30 / 4, 2 + 15]), ([0, 1, 1, 1], [1 + 1, 2])):
            assert self.returns([1, 1, 0, 0], no_bootstrap, 3)[:2] == expected
            garbage_rewards, garbage_values = self.rewards.clone(), self.values.clone()
            garbage_rewards[2:], garbage_values[3:] = 1e9, -1e9
            again = shared("n_step_returns")(
                garbage_rewards, garbage_values, flags([1, 1, 0, 0]), flags(no_bootstrap), GAMMA, 3
            )
            assert again.flatten().tolist()[:2] == expected

    def test_against_the_definition(self):
        """Random episodes of many lengths and ends, agents with rewards of their own, by a loop over the definition."""
        generator = torch.Generator().manual_seed(0)
        steps, n_envs, n_agents, gamma = 12, 40, 2, 0.9
        rewards = torch.randn(steps, n_envs, n_agents, generator=generator)
        values = torch.randn(steps + 1, n_envs, n_agents, generator=generator)
        lengths = torch.randint(1, steps + 1, (n_envs,), generator=generator)
        real_end = torch.rand(n_envs, generator=generator) < 0.5
        time = torch.arange(steps).unsqueeze(1)
        played = time < lengths
        no_bootstrap = (time >= lengths - 1) & real_end
        for n in (1, 3, 5, 20):
            returns = shared("n_step_returns")(rewards, values, played, no_bootstrap, gamma, n)
            for env in range(n_envs):
                length = int(lengths[env])
                for t in range(length):
                    end = min(t + n, length)
                    expected = sum(gamma ** (k - t) * rewards[k, env] for k in range(t, end))
                    if end < length or not real_end[env]:
                        expected = expected + gamma ** (end - t) * values[end, env]
                    torch.testing.assert_close(returns[t, env], expected)


class TestStandardised:
    def test_only_played_steps_count(self):
        result = shared("standardised")(column([1.0, 3.0, 100.0]), flags([1, 1, 0])).flatten()
        deviation = math.sqrt(2.0)  # of 1 and 3, unbiased
        expected = [-1 / (deviation + 1e-5), 1 / (deviation + 1e-5)]
        assert result[:2].tolist() == pytest.approx(expected, rel=1e-6)

    def test_constant_rewards_and_single_steps_become_zeros(self):
        for values in ([0.1] * 7, [0.3]):
            assert (shared("standardised")(column(values), flags([1] * len(values))) == 0).all()

    def test_each_agents_own_rewards_have_their_own_mean_and_deviation(self):
        """What an opponent earns changes nothing."""
        generator = torch.Generator().manual_seed(1)
        rewards = torch.randn(4, 3, 2, generator=generator) * torch.tensor([3.0, 0.1]) + torch.tensor([7.0, -5.0])
        played = torch.rand(4, 3, generator=generator) < 0.7
        result = shared("standardised")(rewards, played)
        for agent in range(2):
            alone = shared("standardised")(rewards[..., [agent]], played)
            torch.testing.assert_close(result[..., [agent]], alone)
            assert result[played][:, agent].mean().abs() < 1e-5
            assert result[played][:, agent].std() == pytest.approx(1, abs=1e-3)


def test_played_mean():
    x = torch.tensor([[[1.0, 3.0], [100.0, 100.0]], [[5.0, 7.0], [9.0, 11.0]]])  # [time 2, env 2, agent 2]
    played = torch.tensor([[True, False], [True, True]])
    assert float(shared("played_mean")(x, played)) == (1 + 3 + 5 + 7 + 9 + 11) / 6


class TestPolicies:
    def test_masked_actions_have_no_probability_and_no_gradient(self):
        logits = torch.tensor([[1.0, 2.0, 3.0]], requires_grad=True)
        masks = torch.tensor([[True, False, True]])
        log_probs = shared("log_probabilities")(logits, masks)
        expected = torch.tensor([1.0, 3.0]).log_softmax(-1)
        torch.testing.assert_close(log_probs[0, [0, 2]], expected)
        assert log_probs.exp()[0, 1] == 0
        entropy = -(log_probs.exp() * log_probs).sum()
        torch.testing.assert_close(entropy, -(expected.exp() * expected).sum())
        entropy.backward()
        assert logits.grad is not None and torch.isfinite(logits.grad).all() and logits.grad[0, 1] == 0

    def test_samples_follow_the_softmax_and_the_mask(self):
        logits = torch.tensor([0.0, 1.0, 5.0, 2.0]).expand(40_000, 4)
        masks = torch.tensor([True, True, False, True]).expand(40_000, 4)
        actions = shared("sample_actions")(logits, masks, torch.Generator().manual_seed(0))
        frequencies = torch.bincount(actions, minlength=4) / len(actions)
        expected = torch.tensor([0.0, 1.0, -torch.inf, 2.0]).softmax(-1)
        assert frequencies[2] == 0
        # five standard errors of a frequency near one half in 40,000 draws
        torch.testing.assert_close(frequencies, expected, atol=5 * 0.5 / 200, rtol=0)


class TestNetworks:
    def networks(self, parameter_sharing=True, core="fc"):
        """Of three agents, with four inputs and two outputs."""
        module = script(NINE[0])
        args = args_of(module, hidden_dim=8, parameter_sharing=parameter_sharing)
        return module.MultiAgentNetwork(args, 3, 4, 2, core)

    def test_shared_network_sees_the_agents_id(self):
        networks = self.networks()
        x = torch.randn(5, 6, 3, 4)
        outputs, _ = networks(x)
        assert len(networks.networks) == 1 and outputs.shape == (5, 6, 3, 2)
        first, core, last = networks.networks[0].first, networks.networks[0].core, networks.networks[0].last
        for agent in range(3):
            own_id = torch.eye(3)[agent].expand(5, 6, 3)
            alone = last(core(first(torch.cat([x[:, :, agent], own_id], -1)).relu()).relu())
            torch.testing.assert_close(outputs[:, :, agent], alone)

    def test_without_sharing_each_agent_has_its_own_network(self):
        networks = self.networks(parameter_sharing=False)
        x = torch.randn(5, 6, 3, 4)
        outputs, _ = networks(x)
        assert len(networks.networks) == 3 and outputs.shape == (5, 6, 3, 2)
        for agent in range(3):
            torch.testing.assert_close(outputs[:, :, [agent]], networks.networks[agent](x[:, :, [agent]])[0])

    @pytest.mark.parametrize("sharing", [True, False])
    def test_what_all_agents_see_alike_is_given_once(self, sharing):
        networks = self.networks(sharing)
        x = torch.randn(5, 6, 1, 4)
        torch.testing.assert_close(networks(x)[0], networks(x.repeat(1, 1, 3, 1))[0])

    @pytest.mark.parametrize("sharing", [True, False])
    def test_recurrent_sequence_equals_its_steps(self, sharing):
        networks = self.networks(sharing, "gru")
        x = torch.randn(5, 6, 3, 4)
        together, _ = networks(x)
        hidden = None
        for t in range(5):
            step, hidden = networks(x[t : t + 1], hidden)
            torch.testing.assert_close(step[0], together[t])

    def test_target_updates(self):
        update_target = shared("update_target")
        online, target = torch.nn.Linear(2, 2), torch.nn.Linear(2, 2)
        before = target.weight.clone()
        update_target(target, online, "soft", 7)
        torch.testing.assert_close(target.weight, 0.99 * before + 0.01 * online.weight)
        moved = target.weight.clone()
        for update in (1, 100, 199):
            update_target(target, online, "hard", update)
            assert torch.equal(target.weight, moved)
        for update in (200, 400):
            update_target(target, online, "hard", update)
            assert torch.equal(target.weight, online.weight) and torch.equal(target.bias, online.bias)
            torch.nn.init.normal_(online.weight)

    def test_gradient_norm_is_clipped_over_all_parameters(self):
        a, b = torch.nn.Parameter(torch.zeros(1)), torch.nn.Parameter(torch.zeros(1))
        optimiser = torch.optim.SGD([a, b], lr=1.0)
        shared("gradient_step")(30 * a.sum() + 40 * b.sum(), optimiser, 10.0)  # gradient (30, 40), norm 50
        assert a.item() == pytest.approx(-6, rel=1e-5) and b.item() == pytest.approx(-8, rel=1e-5)

    def test_all_parameter_groups_learn(self):
        """As where a copy of a script gives a part of its network another learning rate."""
        a, b, frozen = (torch.nn.Parameter(torch.zeros(())) for _ in range(3))
        optimiser = torch.optim.SGD([a], lr=1.0)
        optimiser.add_param_group({"params": [b], "lr": 0.1})
        norm = shared("gradient_step")(30 * a + 40 * b + frozen, optimiser, 10.0)  # norm 50, clipped to a fifth
        assert [norm.item(), a.item(), b.item(), frozen.item()] == pytest.approx([50, -6, -0.8, 0], abs=1e-4)


class TestCollect:
    """The batch against a second environment that plays the same actions, one step at a time."""

    @pytest.mark.parametrize("time_limit", ["bootstrap", "terminal"])
    @pytest.mark.parametrize("individual", [False, True])
    def test_batch_is_what_was_played(self, time_limit, individual):
        module, task = script("ia2c"), "lbf-5x5-2p-1f"
        args = args_of(module, env=task, hidden_dim=16, time_limit=time_limit, individual_rewards=individual)
        env = envs.make(task, 20, seed=3, copy=False)
        rng = torch.manual_seed(0)
        agents = module.MultiAgentNetwork(args, env.n_agents, env.obs_size, env.n_actions)
        team, arrays = module.Team(args, agents, rng), module.new_storage(args, env)
        module.collect(args, env, team, arrays)  # leaves traces in the arrays that the second must not keep
        batch, returns = module.collect(args, env, team, arrays)

        mirror = envs.make(task, 20, seed=3)
        mirror.episode = 1
        observations, info = mirror.reset()
        ended, lengths, sums = np.zeros(20, bool), np.zeros(20, int), np.zeros(20)
        for t in range(len(batch.actions)):
            np.testing.assert_array_equal(batch.observations[t], observations)
            np.testing.assert_array_equal(batch.states[t], info["state"])
            np.testing.assert_array_equal(batch.played[t], ~ended)
            lengths += ~ended
            observations, rewards, terminated, truncated, info = mirror.step(batch.actions[t].numpy())
            np.testing.assert_array_equal(batch.rewards[t], info["agent_rewards"] if individual else rewards[:, None])
            sums += rewards
            ended = terminated | truncated
            np.testing.assert_array_equal(batch.no_bootstrap[t], ended if time_limit == "terminal" else terminated)
        np.testing.assert_array_equal(batch.observations[-1], observations)
        assert ended.all() and len(batch.observations) == lengths.max() + 1
        assert terminated.any() and truncated.any()  # both kinds of end were seen
        assert int(batch.played.sum()) == lengths.sum()
        np.testing.assert_allclose(returns, sums)  # the team's, also where each agent learns from its own rewards


@pytest.mark.parametrize("name", nine(ON_POLICY))
@pytest.mark.parametrize("sharing", [True, False])
@pytest.mark.parametrize("network", ["fc", "gru"])
@pytest.mark.parametrize("individual", [False, True])
@pytest.mark.slow
def test_every_parameter_learns(monkeypatch, name, sharing, network, individual):
    """After one update every parameter of actors and critics, of each agent's own networks too, has a gradient."""
    if name == "coma" and individual:
        pytest.skip("COMA learns from the team's reward alone")
    flags = {"parameter_sharing": sharing, "network": network, "hidden_dim": 16, **own_rewards(individual)}
    run = trained(monkeypatch, name, 1, reward_standardisation=True, **flags)
    for part in ("agents", "critic"):
        for parameter_name, parameter in run.parts[part].named_parameters():
            assert parameter.grad is not None and parameter.grad.abs().max() > 0, (part, parameter_name)
    assert all(parameter.grad is None for parameter in run.parts["target_critic"].parameters())


@pytest.mark.parametrize("network", ["fc", "gru"])
@pytest.mark.parametrize("name", NAMES)
def test_what_is_trained_and_how_fast(monkeypatch, name, network):
    """The flags reach their parts; targets begin as copies; critics are never recurrent."""
    parts = trained(monkeypatch, name, 0, network=network, learning_rate=0.0123).parts
    optimised = []
    for part, value in parts.items():
        if part.endswith("optimiser"):
            optimised += [id(weights) for group in value.param_groups for weights in group["params"]]
            assert [group["lr"] for group in value.param_groups] == [0.0123]
            continue
        recurrent = any(isinstance(module, torch.nn.GRU) for module in value.modules())
        assert recurrent == (network == "gru" and part.endswith("agents")), part
        if part.startswith("target_"):
            online = parts[part.removeprefix("target_")]
            assert all(torch.equal(a, b) for a, b in zip(value.parameters(), online.parameters(), strict=True))
    learning = [value for part, value in parts.items() if not part.startswith("target_") and "optimiser" not in part]
    assert sorted(optimised) == sorted(id(weights) for value in learning for weights in value.parameters())


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.slow
def test_the_seed_reaches_networks_actions_and_environments(monkeypatch, name):
    def begin(seed):
        """The networks' weights, what the generator draws next, and the first observations."""
        run = trained(monkeypatch, name, 0, seed=seed, hidden_dim=16)
        weights = torch.cat([parameter.flatten() for parameter in run.parts["agents"].parameters()])
        return weights, torch.rand(5, generator=run.rng), torch.from_numpy(run.env.reset()[0].copy())

    for first, same, other in zip(begin(0), begin(0), begin(1)):
        assert torch.equal(first, same) and not torch.equal(first, other)


class TestComa:
    def test_inputs_hide_the_own_action(self):
        states = torch.tensor([[[7.0, 8.0]]])  # [time 1, env 1, state 2]
        actions = torch.tensor([[[1, 0, 2]]])  # [time 1, env 1, agent 3]
        inputs = script("coma").counterfactual_inputs(states, actions, 3)
        one_hots = [[0, 1, 0], [1, 0, 0], [0, 0, 1]]
        for agent in range(3):
            others = [[0, 0, 0] if other == agent else one_hots[other] for other in range(3)]
            assert inputs[0, 0, agent].tolist() == [7, 8, *(x for other in others for x in other)]
