"""The inverse models: what they learn, their losses, their files, and what they refuse."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from saver_envs.modelling.arms import Task, arm_named
from saver_envs.modelling.models import (
    ADVERSARIAL,
    MODELS,
    InverseModel,
    Training,
    load_model,
    new_model,
    read_card,
)
from saver_envs.modelling.models.adversarial import WEIGHT_BOUND, AdversarialModel
from saver_envs.modelling.models.flow import ConditionalFlow, Flow
from saver_envs.modelling.networks import (
    ACTIVATIONS,
    FrozenNetwork,
    MLPArchitecture,
    Precision,
    build_network,
)
from saver_envs.modelling.newton_euler import inverse_dynamics
from saver_envs.weights import write_weights

SMALL = MLPArchitecture(layers=2, width=32)
QUICK = Training(epochs=4, batch_size=64)
NETWORKS = ("mlp", *ADVERSARIAL, "conditional", "flow")


def kinematic_samples(n: int = 600, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Hands in front of a MICO, in the order of a slow motion, one answer each."""
    time = np.linspace(0, 20, n)[:, None]
    phase = np.random.default_rng(seed).uniform(0, 6, 4)
    joints = np.array([0.0, 2.2, 4.2, 0.0]) + 0.3 * np.sin(time * (0.7, 1.1, 1.7, 0.0) + phase)
    return arm_named("mico").chain.position(joints), joints


def dynamic_samples(n: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """Motions of a MICO with heavier links, friction, damping and armature."""
    generator = np.random.default_rng(0)
    motion = generator.normal(size=(n, 12)) * np.repeat((0.6, 0.4, 0.5), 4)
    motion[:, :4] += (0, 2.2, 4.2, 0)
    position, velocity, acceleration = np.split(motion, 3, axis=1)
    arm = arm_named("mico")
    assert arm.appendix_links is not None
    torque = inverse_dynamics(arm.chain, arm.appendix_links(), position, velocity, acceleration)
    torque = 1.1 * torque + 0.4 * np.sign(velocity) + 0.3 * velocity + 0.15 * acceleration
    return motion, torque


def small(name: str, task: Task = "ik", robot: str = "mico") -> InverseModel:
    if name in ("analytic", "identified"):
        return new_model(name, robot, task)
    return new_model(name, robot, task, architecture=SMALL)


@pytest.mark.parametrize("name", NETWORKS)
def test_every_network_learns_saves_and_comes_back(name: str, tmp_path: Path) -> None:
    inputs, joints = kinematic_samples()
    model = small(name)
    reported: list[int] = []
    history = model.fit(inputs, joints, QUICK, lambda epoch, _: reported.append(epoch))
    assert reported == [0, 1, 2, 3]
    assert len(history.validation_rmse) == 4
    best = min(history.validation_rmse)
    assert history.validation_rmse[history.best_epoch] == best
    assert np.sqrt(np.mean(np.square(history.per_output))) == pytest.approx(best)
    present = joints if model.needs_present else None
    predicted = model.predict(inputs, present)
    assert predicted.shape == joints.shape
    assert np.isfinite(predicted).all()
    path = tmp_path / "model.safetensors"
    model.save(path, {"seed": 0})
    again = load_model(path, "mico", "ik")
    assert type(again) is type(model)
    assert np.array_equal(again.predict(inputs, present), predicted)
    assert read_card(path) == {"seed": 0}
    # One by one as all together, but for the rounding of the products' order.
    one = again.predict(inputs[:1], None if present is None else present[:1])
    assert np.abs(one - predicted[:1]).max() < 1e-5


@pytest.mark.parametrize("name", ["mlp", "conditional", "flow"])
def test_what_is_supervised_comes_near(name: str) -> None:
    inputs, joints = kinematic_samples(1000)
    model = small(name)
    training = Training(epochs=25, batch_size=64, learning_rate=3e-3)
    model.fit(inputs, joints, training)
    present = joints if model.needs_present else None
    error = model.predict(inputs, present) - joints
    assert np.sqrt(np.square(error).mean()) < 0.3 * joints[:, :3].std(axis=0).mean()


def test_bfloat16_keeps_weights_and_ends_in_float32() -> None:
    torch.manual_seed(0)
    half = build_network(5, 3, MLPArchitecture(layers=3, width=64), "bfloat16")
    full = build_network(5, 3, MLPArchitecture(layers=3, width=64))
    full.load_state_dict(half.state_dict(), strict=True)
    values = torch.randn(50, 5)
    assert half(values).dtype == torch.float32
    assert all(parameter.dtype == torch.float32 for parameter in half.parameters())
    difference = (half(values) - full(values)).abs().max()
    assert 0 < difference < 0.02
    half(values).square().mean().backward()
    assert all(parameter.grad is not None for parameter in half.parameters())
    with pytest.raises(ValueError, match="precision='half'"):
        Training(precision="half")  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
@pytest.mark.parametrize("name", ADVERSARIAL)
def test_adversarial_models_learn_without_a_supervised_term(
    name: str, precision: Precision
) -> None:
    inputs, joints = kinematic_samples(2000)
    model = new_model(name, "mico", "ik", architecture=SMALL)
    model.fit(inputs, joints, Training(epochs=30, batch_size=64, precision=precision))
    error = (model.predict(inputs) - joints)[:, :3]
    assert np.sqrt(np.square(error).mean()) < 0.5 * np.sqrt(joints[:, :3].var(axis=0).mean())


def test_training_is_reproducible_from_its_seed() -> None:
    inputs, joints = kinematic_samples(200)
    results = []
    for seed in (0, 0, 1):
        model = small("cgan")
        model.fit(inputs, joints, Training(epochs=2, batch_size=64, sigma=0.2, seed=seed))
        results.append(model.predict(inputs))
    assert np.array_equal(results[0], results[1])
    assert not np.allclose(results[0], results[2])


# Losses ------------------------------------------------------------------------------------------


def prepared(
    name: str, sigma: float = 0.0
) -> tuple[AdversarialModel, Tensor, Tensor, list[Tensor], Tensor]:
    """A model ready to learn, a batch, its fakes and its real samples, in double precision."""
    torch.manual_seed(0)
    model = small(name)
    assert isinstance(model, AdversarialModel)
    model._prepare(Training(sigma=sigma))
    for network in (*model._generators, *model._discriminators):
        network.double()
    inputs, outputs = torch.randn(40, 3).double(), torch.randn(40, 4).double()
    fakes = model._fakes(inputs, outputs)
    return model, inputs, outputs, fakes, torch.cat([inputs, outputs], dim=1)


def test_equation_7_8() -> None:
    model, inputs, outputs, (fake,), real = prepared("cgan")
    discriminator = model._discriminators[0]
    value = (
        discriminator(real).sigmoid().log().mean()
        + (1 - discriminator(fake).sigmoid()).log().mean()
    )
    assert torch.allclose(model._discriminator_loss(real, [fake]), -value)
    wanted = (1 - discriminator(fake).sigmoid()).log().mean()
    assert torch.allclose(model._generator_loss(inputs, outputs, [fake]), wanted)
    assert torch.equal(fake, torch.cat([inputs, model._generators[0](inputs)], dim=1))


def test_equation_7_9() -> None:
    model, inputs, outputs, (fake,), real = prepared("lsgan")
    discriminator = model._discriminators[0]
    wanted = 0.5 * ((discriminator(real) - 1) ** 2).mean() + 0.5 * (discriminator(fake) ** 2).mean()
    assert torch.allclose(model._discriminator_loss(real, [fake]), wanted)
    wanted = 0.5 * ((discriminator(fake) - 1) ** 2).mean()
    assert torch.allclose(model._generator_loss(inputs, outputs, [fake]), wanted)


@pytest.mark.parametrize("sigma", [0.0, 0.4])
def test_equations_7_10_and_7_11(sigma: float) -> None:
    model, inputs, outputs, fakes, real = prepared("bigan", sigma)
    discriminator, (generator, encoder) = model._discriminators[0], model._generators
    fooled = sum((1 - discriminator(fake).sigmoid()).log().mean() for fake in fakes)
    value = discriminator(real).sigmoid().log().mean() + fooled
    assert torch.allclose(model._discriminator_loss(real, fakes), -value)
    loop = ((inputs - encoder(generator(inputs))) ** 2).sum(dim=1).mean()
    assert torch.allclose(
        model._generator_loss(inputs, outputs, fakes), fooled + Training().loop_weight * loop
    )
    # The second kind of fakes is made by the encoder from outputs.
    assert torch.allclose(fakes[1][:, :3], encoder(fakes[1][:, 3:]))


@pytest.mark.parametrize("sigma", [0.0, 0.4])
def test_equations_7_12_and_7_13(sigma: float) -> None:
    model, inputs, outputs, fakes, real = prepared("dualgan", sigma)
    first, second = model._discriminators
    there, back = model._generators
    wanted = first(fakes[0]).mean() - first(real).mean()
    wanted = wanted + second(fakes[1]).mean() - second(real).mean()
    assert torch.allclose(model._discriminator_loss(real, fakes), wanted)
    loops = ((inputs - back(there(inputs))) ** 2).sum(dim=1).mean()
    loops = loops + ((outputs - there(back(outputs))) ** 2).sum(dim=1).mean()
    wanted = Training().loop_weight * loops - first(fakes[0]).mean() - second(fakes[1]).mean()
    assert torch.allclose(model._generator_loss(inputs, outputs, fakes), wanted)
    model._after_discriminators()
    assert max(float(p.detach().abs().max()) for p in first.parameters()) <= WEIGHT_BOUND


@pytest.mark.parametrize("name", ADVERSARIAL)
def test_fakes_spread_by_sigma_round_the_real_inputs(name: str) -> None:
    model, _, outputs, _, _ = prepared(name, 0.6)
    many = torch.zeros(4000, 3).double()
    near = model._fakes(many, outputs.repeat(100, 1))[0][:, :3]
    assert float(near.std()) == pytest.approx(0.6, rel=0.05)
    exact, inputs, _, fakes, _ = prepared(name, 0.0)
    assert torch.equal(fakes[0][:, :3], inputs)
    assert exact._supervised == 0


@pytest.mark.parametrize("name", ADVERSARIAL)
def test_each_side_learns_in_its_own_turn(name: str) -> None:
    model, inputs, outputs, _, _ = prepared(name, 0.2)

    def state(networks: list[torch.nn.Module]) -> Tensor:
        return torch.cat([p.detach().flatten().clone() for n in networks for p in n.parameters()])

    generators, discriminators = state(model._generators), state(model._discriminators)
    model._update(inputs, outputs)
    assert not torch.equal(generators, state(model._generators))
    assert not torch.equal(discriminators, state(model._discriminators))
    assert all(p.requires_grad for n in model._discriminators for p in n.parameters())


def test_the_flow_turns_back_what_it_turned() -> None:
    torch.manual_seed(0)
    flow = ConditionalFlow(3, 4, SMALL)
    for net in flow.nets:
        torch.nn.init.normal_(net[-1].weight, std=0.3)  # type: ignore[index]
    model = small("flow")
    assert isinstance(model, Flow)
    frozen = model._frozen_of(flow.state_dict())
    normal = np.random.default_rng(0).standard_normal((50, 4)).astype(np.float32)
    condition = np.random.default_rng(1).standard_normal((50, 3)).astype(np.float32)
    values = torch.from_numpy(frozen(condition, normal))
    # log p differs between two draws as the normal's density and the map's volume say.
    likelihood = flow.log_likelihood(values, torch.from_numpy(condition))
    one = values[:1].clone().requires_grad_(True)

    def back(joints: Tensor) -> Tensor:
        given = torch.from_numpy(condition[:1])
        for layer, net in enumerate(flow.nets):
            kept = [index for index in range(4) if index % 2 == layer % 2]
            changed = [index for index in range(4) if index not in kept]
            shift, raw = net(torch.cat([given, joints[:, kept]], dim=1)).chunk(2, dim=1)
            joints = joints.clone()
            joints[:, changed] = (joints[:, changed] - shift) * torch.exp(-2 * torch.tanh(raw))
        return joints

    assert np.abs(back(one).detach().numpy() - normal[:1]).max() < 1e-4
    jacobian = torch.autograd.functional.jacobian(lambda q: back(q)[0], one)[:, 0]
    wanted = torch.linalg.slogdet(jacobian)[1] - 0.5 * torch.from_numpy(normal[0]).square().sum()
    assert float(likelihood[0]) == pytest.approx(float(wanted), abs=1e-3)


def test_of_the_flows_draws_the_nearest_is_taken() -> None:
    inputs, joints = kinematic_samples(300)
    model = small("flow")
    model.fit(inputs, joints, QUICK)
    assert isinstance(model, Flow)
    near = np.abs(model.predict(inputs, joints) - joints).mean()
    assert near < np.abs(model.predict(inputs) - joints).mean()


# Dynamics ----------------------------------------------------------------------------------------


def test_identified_dynamics_find_the_plant() -> None:
    pytest.importorskip("mujoco.sysid").ParameterDict  # noqa: B018
    motion, torque = dynamic_samples()
    model = new_model("identified", "mico", "id")
    analytic = new_model("analytic", "mico", "id")
    model.fit(motion, torque)
    error = np.sqrt(np.square(model.predict(motion) - torque).mean())
    before = np.sqrt(np.square(analytic.predict(motion) - torque).mean())
    assert before > 0.4
    assert error < 0.15 * before


@pytest.mark.parametrize("name", ["analytic", "identified"])
def test_models_without_networks_come_back(name: str, tmp_path: Path) -> None:
    motion, torque = dynamic_samples(60)
    model = new_model(name, "mico", "id")
    model.fit(motion, torque)
    path = tmp_path / "model.safetensors"
    model.save(path)
    again = load_model(path)
    assert np.array_equal(again.predict(motion), model.predict(motion))


def test_the_analytic_dynamics_are_newton_eulers() -> None:
    motion, _ = dynamic_samples(50)
    arm = arm_named("fetch")
    assert arm.appendix_links is not None
    wide = np.random.default_rng(0).normal(size=(20, 24))
    torque = inverse_dynamics(arm.chain, arm.appendix_links(), *np.split(wide, 3, axis=1))
    assert np.array_equal(new_model("analytic", "fetch", "id").predict(wide), torque)
    assert new_model("analytic", "mico", "id").predict(motion).shape == (50, 4)


def test_the_analytic_kinematics_are_exact() -> None:
    for robot in ("mico", "jaco", "fetch"):
        arm = arm_named(robot)
        home = np.asarray(arm.robot.home)
        joints = home + np.random.default_rng(0).normal(scale=0.1, size=(20, arm.dof))
        targets = arm.chain.position(joints)
        if arm.target_size == 6:
            targets = np.concatenate([targets, np.zeros_like(targets)], axis=1)
        found = new_model("analytic", robot, "ik").predict(targets, joints)
        assert np.abs(arm.chain.position(found) - targets[:, :3]).max() < 1e-4


# Networks ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("rows", [1, 7, 600])
def test_numpy_computes_what_torch_does(activation: str, rows: int) -> None:
    torch.manual_seed(0)
    architecture = MLPArchitecture(3, 48, activation, 0.3)  # type: ignore[arg-type]
    network = build_network(5, 3, architecture)
    frozen = FrozenNetwork(network.state_dict(), architecture)
    values = torch.randn(rows, 5)
    with torch.no_grad():
        wanted = network(values).numpy()
    given = values.numpy().copy()
    assert np.abs(frozen(given) - wanted).max() < 1e-5
    assert np.array_equal(given, values.numpy())


def test_layers_are_hidden_ones() -> None:
    network = build_network(3, 4, MLPArchitecture(layers=3, width=256))
    widths = [m.out_features for m in network if isinstance(m, torch.nn.Linear)]
    assert widths == [256, 256, 256, 4]
    # The discriminators and generators of dynamics have five.
    assert new_model("cgan", "mico", "id").architecture.layers == 5  # type: ignore[attr-defined]


# Refusals ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"layers": 0}, "layers=0"),
        ({"width": 0}, "width=0"),
        ({"activation": "tanh"}, "activation='tanh'"),
        ({"leak": 1.5}, "leak=1.5"),
    ],
)
def test_wrong_architectures_are_named(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MLPArchitecture(**options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "options",
    [
        {"epochs": 0},
        {"batch_size": 0},
        {"learning_rate": 0.0},
        {"validation_share": 1.0},
        {"sigma": -0.1},
        {"supervised_weight": float("nan")},
        {"loop_weight": -1.0},
        {"decay": 0.0},
    ],
)
def test_wrong_trainings_are_named(options: dict[str, float]) -> None:
    name, value = next(iter(options.items()))
    with pytest.raises(ValueError, match=f"{name}={value}"):
        Training(**options)  # type: ignore[arg-type]


def test_wrong_models_are_named() -> None:
    with pytest.raises(ValueError, match="model='wgan': must be one of mlp, cgan"):
        new_model("wgan", "mico", "ik")
    with pytest.raises(ValueError, match="robot='panda'"):
        new_model("mlp", "panda", "ik")
    with pytest.raises(ValueError, match="task='fk'"):
        new_model("mlp", "mico", "fk")  # type: ignore[arg-type]
    for name in ("conditional", "flow"):
        with pytest.raises(ValueError, match="task='id'"):
            new_model(name, "mico", "id")
    with pytest.raises(ValueError, match="task='ik'"):
        new_model("identified", "mico", "ik")
    for name in ("identified", "analytic"):
        with pytest.raises(ValueError, match="Appendix A"):
            new_model(name, "jaco", "id")


@pytest.mark.parametrize("name", sorted(MODELS))
def test_wrong_samples_are_named(name: str) -> None:
    task: Task = "id" if name == "identified" else "ik"
    model = small(name, task)
    size = model.input_size
    with pytest.raises(ValueError, match=r"inputs of shape \(5, 7\)"):
        model.fit(np.zeros((5, 7)), np.zeros((5, 4)))
    with pytest.raises(ValueError, match=r"outputs of shape \(5, 8\)"):
        model.fit(np.zeros((5, size)), np.zeros((5, 8)))
    with pytest.raises(ValueError, match="outputs: every value must be finite"):
        model.fit(np.zeros((5, size)), np.full((5, 4), np.nan))
    with pytest.raises(ValueError, match="5 inputs and 6 outputs"):
        model.fit(np.zeros((5, size)), np.zeros((6, 4)))
    if name != "analytic":
        with pytest.raises(ValueError, match="not fitted"):
            model.predict(np.zeros((1, size)), np.zeros((1, 4)))


def test_conditional_needs_the_present_joints() -> None:
    inputs, joints = kinematic_samples(100)
    model = small("conditional")
    model.fit(inputs, joints, Training(epochs=1))
    with pytest.raises(ValueError, match="present=None"):
        model.predict(inputs)


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    inputs, joints = kinematic_samples(100)
    model = small("mlp")
    with pytest.raises(ValueError, match="not fitted"):
        model.save(tmp_path / "model.safetensors")
    model.fit(inputs, joints, Training(epochs=1))
    with pytest.raises(ValueError, match="must end in"):
        model.save(tmp_path / "model.bin")
    path = tmp_path / "model.safetensors"
    model.save(path)
    for robot, task, message in (
        ("jaco", "ik", "of robot 'mico', not 'jaco'"),
        ("mico", "id", "of task 'ik', not 'id'"),
    ):
        with pytest.raises(ValueError, match=message):
            load_model(path, robot, task)  # type: ignore[arg-type]
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="not a complete safetensors"):
        load_model(path)
    save_file({"weight": torch.zeros(3)}, path)
    with pytest.raises(ValueError, match="is not a saver-inverse-model file"):
        load_model(path)
    header = {"model": "mlp", "robot": "mico", "task": "ik"}
    write_weights(path, "saver-inverse-model", {"weight": torch.zeros(3)}, header)
    with pytest.raises(ValueError, match="contradicts itself"):
        load_model(path)
