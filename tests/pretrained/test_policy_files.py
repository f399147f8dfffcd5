import json
import pickle
import zipfile
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from saver_advisors.advising import make_advisor
from saver_advisors.policies import files as policy_files
from saver_advisors.policies.cards import PolicyCard, card_markdown
from saver_advisors.policies.files import (
    WEIGHTS_DIR,
    load_policy,
    load_teacher,
    read_networks,
    save_policy,
    shipped_policies,
    write_card,
)
from saver_advisors.policies.networks import NetworkSpec
from saver_envs.weights import read_weights, write_weights


def observations(n=6):
    rng = np.random.default_rng(0)
    return {
        "observation": rng.normal(size=(n, 28)),
        "achieved_goal": rng.normal(size=(n, 3)),
        "desired_goal": rng.normal(size=(n, 3)),
    }


@pytest.fixture
def saved(tmp_path, networks, card):
    return save_policy(tmp_path / "jaco-toy.safetensors", networks, card)


def test_weights_and_card_come_back(saved, networks, card):
    policy = load_policy(saved)
    for name, value in networks.state_dict().items():
        assert torch.equal(policy.networks.state_dict()[name], value), name
    assert policy.networks.spec == networks.spec
    assert policy.card == replace(card, networks=networks.spec)
    assert policy.name == "jaco-toy"
    assert all(tensor.dtype == torch.float32 for tensor in load_file(saved).values())


def test_predict_is_the_formula(saved, networks):
    """By hand, in NumPy: normalise, clip, ReLU layers, tanh, the action box."""
    obs = {key: 4 * values for key, values in observations().items()}  # so that some are clipped
    weights = {name: value.numpy() for name, value in networks.state_dict().items()}
    x = np.concatenate([obs["observation"], obs["desired_goal"]], axis=1)
    x = np.clip((x - weights["mean"]) / weights["std"], -5, 5)
    for layer in (0, 2):
        x = np.maximum(x @ weights[f"actor.{layer}.weight"].T + weights[f"actor.{layer}.bias"], 0)
    x = np.tanh(x @ weights["actor.4.weight"].T + weights["actor.4.bias"])
    low, high = weights["action_low"], weights["action_high"]
    expected = low + (x + 1) / 2 * (high - low)
    policy = load_policy(saved)
    actions, state = policy.predict(obs)
    np.testing.assert_allclose(actions, expected, rtol=1e-4, atol=1e-5)
    assert state is None
    assert actions.dtype == np.float32
    for row in range(len(actions)):
        single, _ = policy.predict({key: values[row] for key, values in obs.items()})
        assert single.shape == (3,)
        np.testing.assert_allclose(single, actions[row], rtol=1e-5, atol=1e-6)


def test_the_teacher_of_a_policy_acts_alike(saved, networks):
    obs = observations()
    teacher = load_teacher(saved)
    acted = teacher.act(obs["observation"], obs["desired_goal"])
    np.testing.assert_array_equal(acted, load_policy(saved).predict(obs)[0])
    assert (teacher.observation_size, teacher.goal_size, teacher.action_size) == (28, 3, 3)
    assert make_advisor("mc-q", saved, 10, n_arms=2).state_dict()["teachers"] == ["jaco-toy"] * 2


def test_wrong_observations_are_named(saved):
    policy, obs = load_policy(saved), observations()
    with pytest.raises(ValueError, match=r"observation has shape \(6, 56\).*\(n, 28\)"):
        policy.predict({**obs, "observation": np.zeros((6, 56))})
    with pytest.raises(ValueError, match="reads 'desired_goal'"):
        policy.predict({"observation": obs["observation"]})
    with pytest.raises(ValueError, match="mixes"):
        policy.predict({**obs, "desired_goal": np.zeros(3)})
    with pytest.raises(ValueError, match="deterministic"):
        policy.predict(obs, deterministic=False)


def test_a_loaded_policy_can_be_saved_again(saved, tmp_path, card):
    again = save_policy(tmp_path / "again.safetensors", load_policy(saved), card)
    obs = observations()
    np.testing.assert_array_equal(
        load_policy(saved).predict(obs)[0], load_policy(again).predict(obs)[0]
    )


def test_truncated_files_are_refused_wherever_they_break(saved, tmp_path):
    data = saved.read_bytes()
    broken = tmp_path / "broken.safetensors"
    for length in (0, 4, 8, 100, len(data) // 2, len(data) - 1):
        broken.write_bytes(data[:length])
        with pytest.raises(ValueError, match=r"broken\.safetensors is not a complete"):
            load_policy(broken)


def test_foreign_files_are_refused(tmp_path):
    path = tmp_path / "foreign.safetensors"
    save_file({"weight": torch.zeros(3)}, path)
    with pytest.raises(ValueError, match=r"foreign\.safetensors is not a saver-policy file"):
        load_policy(path)
    path.write_bytes(b"\xff" * 500)
    with pytest.raises(ValueError, match=r"foreign\.safetensors is not a complete"):
        load_policy(path)


class Evil:
    def __reduce__(self):
        return (open, ("unpickled.txt", "w"))


def test_nothing_is_ever_unpickled(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "evil.safetensors"
    path.write_bytes(pickle.dumps(Evil()))
    with pytest.raises(ValueError, match=r"evil\.safetensors"):
        load_policy(path)
    torch.save({"actor": Evil()}, path)
    with pytest.raises(ValueError, match=r"evil\.safetensors"):
        load_policy(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("policy.pth", pickle.dumps(Evil()))
    with pytest.raises(ValueError, match=r"evil\.safetensors"):
        load_policy(path)
    assert not (tmp_path / "unpickled.txt").exists()


def tamper(path, change):
    """Rewrite a weight file after `change(tensors, card)`, with the checksum of its content."""
    header, tensors = read_weights(path, "saver-policy")
    card = json.loads(header["card"])
    change(tensors, card)
    write_weights(path, "saver-policy", tensors, {"card": json.dumps(card)})


def _set(mapping, key, value):
    mapping[key] = value


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t, c: t.pop("std"), "std.* missing"),
        (lambda t, c: _set(t, "extra", torch.zeros(1)), "extra.* surplus"),
        (lambda t, c: _set(t, "std", torch.zeros(31)), "std and clip must be positive"),
        (lambda t, c: _set(t, "mean", torch.full((31,), torch.nan)), "mean holds .* not finite"),
        (lambda t, c: _set(t, "mean", torch.zeros(30)), r"mean is .*\(30,\).*\(31,\)"),
        (lambda t, c: _set(t, "mean", torch.zeros(31).half()), "F16"),
        (lambda t, c: _set(t, "action_high", t["action_low"].clone()), "must exceed"),
        (lambda t, c: _set(c["networks"], "actor_hidden", [16, 13]), "actor.2.weight is"),
        (
            lambda t, c: _set(c["networks"], "actor_hidden", [10**9]),
            "actor_hidden holds 1000000000",
        ),
        (lambda t, c: _set(c["networks"], "actor_hidden", [60_000] * 60), "missing or surplus"),
        (lambda t, c: _set(c["networks"], "activation", "os.system"), "activation='os.system'"),
        (lambda t, c: _set(c["networks"], "inputs", [["camera", 31]]), "camera"),
        (lambda t, c: c["networks"].pop("inputs"), "not a network description"),
        (lambda t, c: _set(c, "networks", None), "does not describe the networks"),
        (lambda t, c: _set(c, "success", 1.2), "success=1.2"),
        (lambda t, c: _set(c, "colour", "red"), "colour"),
        (lambda t, c: c.pop("seed"), "seed"),
    ],
)
def test_inconsistent_files_are_refused(saved, change, message):
    tamper(saved, change)
    with pytest.raises(ValueError, match=message) as raised:
        load_policy(saved)
    assert "jaco-toy.safetensors" in str(raised.value)


def test_unknown_names_list_the_shipped_ones(tmp_path, networks, card, monkeypatch):
    monkeypatch.setattr(policy_files, "WEIGHTS_DIR", tmp_path)
    for name in ("jaco-push", "jaco-lift"):
        save_policy(tmp_path / f"{name}.safetensors", networks, card)
    assert shipped_policies() == ["jaco-lift", "jaco-push"]
    assert load_policy("jaco-push").name == "jaco-push"
    with pytest.raises(ValueError, match=r"'jaco-pull' is unknown: .* jaco-lift, jaco-push"):
        load_policy("jaco-pull")
    with pytest.raises(ValueError, match="no weight file"):
        load_policy(tmp_path / "jaco-pull.safetensors")


def test_saving_refuses_what_loading_would(tmp_path, networks, card):
    with pytest.raises(ValueError, match=r"\.safetensors"):
        save_policy(tmp_path / "weights.pt", networks, card)
    networks.mean[0] = torch.nan
    with pytest.raises(ValueError, match="mean holds"):
        save_policy(tmp_path / "nan.safetensors", networks, card)
    assert not (tmp_path / "nan.safetensors").exists()


@pytest.mark.parametrize(
    "wrong",
    [
        {"success": -0.1},
        {"success": None},
        {"steps": -1},
        {"wall_clock_s": "long"},
        {"env_id": 3},
        {"env_kwargs": "n_arms=3"},
    ],
)
def test_cards_are_checked(card, wrong):
    with pytest.raises((TypeError, ValueError), match=next(iter(wrong))):
        replace(card, **wrong)
    with pytest.raises(ValueError, match="missing"):
        PolicyCard.from_dict({"env_id": "JacoPush-v0"})


def test_the_readable_card_says_what_the_header_says(saved):
    page = saved.with_suffix(".md").read_text()
    for figure in ("# jaco-toy", "JacoPush-v0", "0.940 over 100 episodes", "800,000", "1,620 s"):
        assert figure in page
    for figure in ("0123abc", "GoalTD3", "16 - 12, relu", "2 x (10 - 9, relu, LayerNorm)"):
        assert figure in page
    assert "observation (28), desired_goal (3)" in page
    assert "saver train JacoPush-v0 --seed 3" in page
    saved.with_suffix(".md").unlink()
    assert write_card(saved).read_text() == page


def test_a_card_names_the_environments_arguments(card, networks, tmp_path):
    card = replace(card, env_kwargs={"n_arms": 3})
    path = save_policy(tmp_path / "three.safetensors", networks, card)
    assert load_policy(path).card.env_kwargs == {"n_arms": 3}
    assert "| environment | `JacoPush-v0, n_arms=3` |" in path.with_suffix(".md").read_text()


def test_network_descriptions_survive_json():
    spec = NetworkSpec((("observation", 4),), 2, (8,), (8,), 2, 25, "elu", True, True)
    assert NetworkSpec.from_dict(json.loads(json.dumps(asdict(spec)))) == spec


@pytest.mark.parametrize("name", shipped_policies())
def test_shipped_policies_load_and_their_cards_are_current(name):
    path = WEIGHTS_DIR / f"{name}.safetensors"
    networks, card = read_networks(path)
    assert path.with_suffix(".md").read_text() == card_markdown(name, card)
    sizes = networks.spec.sizes
    observation = {key: np.zeros(size) for key, size in sizes.items()}
    action, _ = load_policy(name).predict(observation)
    assert action.shape == (networks.spec.action_size,)


DEEP = "[" * 100_000
WRONG_CARDS = {
    "steps": ["many", 1.5, True, -1],
    "seed": ["0", None, 0.5],
    "notes": [["a"], "text", None],
    "env_kwargs": [3],
    "networks": ["3 x 256", [1]],
    "success": ["high", 2.0, float("nan")],
    "wall_clock_s": [[], float("inf")],
    "command": [None, 3],
}


@pytest.mark.parametrize("name", WRONG_CARDS)
def test_cards_with_wrong_types_are_named(saved, tmp_path, name):
    header, tensors = read_weights(saved, "saver-policy")
    for value in WRONG_CARDS[name]:
        path = tmp_path / "wrong.safetensors"
        values = {**json.loads(header["card"]), name: value}
        write_weights(path, "saver-policy", tensors, {"card": json.dumps(values)})
        with pytest.raises(ValueError, match=rf"wrong\.safetensors .*{name}"):
            load_policy(path)


@pytest.mark.parametrize("text", [DEEP, "5", "[]", "{", "{}", '{"networks": ' + DEEP])
def test_cards_that_are_none_are_named(saved, tmp_path, text):
    _, tensors = read_weights(saved, "saver-policy")
    path = tmp_path / "wrong.safetensors"
    write_weights(path, "saver-policy", tensors, {"card": text})
    with pytest.raises(ValueError, match=r"wrong\.safetensors contradicts itself"):
        load_policy(path)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("inputs", [["observation", 2.5]]),
        ("inputs", [["observation", float("inf")]]),
        ("inputs", [[["observation"], 3]]),
        ("inputs", 5),
        ("actor_hidden", ["8"]),
        ("actor_hidden", [65_536] * 64),
        ("n_critics", 1.5),
        ("critic_layer_norm", "yes"),
        ("activation", ["relu"]),
    ],
)
def test_networks_of_a_card_are_checked_before_memory_is_taken(saved, tmp_path, name, value):
    header, tensors = read_weights(saved, "saver-policy")
    card = json.loads(header["card"])
    card["networks"][name] = value
    path = tmp_path / "wrong.safetensors"
    write_weights(path, "saver-policy", tensors, {"card": json.dumps(card)})
    with pytest.raises(ValueError, match=r"wrong\.safetensors contradicts itself"):
        load_policy(path)


def test_a_name_that_is_too_long_for_a_path_is_unknown():
    for load in (load_policy, load_teacher):
        with pytest.raises(ValueError, match="is unknown"):
            load("a" * 5_000)
