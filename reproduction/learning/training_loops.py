"""Build the training loops to time: ours as configured, ours with one change, and SB3's."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

from saver_advisors.learner.algorithms import episode_horizon
from saver_advisors.training.building import build_env, build_model

AS_CONFIGURED: Final = "as configured"
UPDATE: Final = "update"
REST: Final = "the rest"
#: Units of the hidden layers of chapter 6's networks.
EIGHT_LAYERS: Final = (512, 512, 256, 256, 256, 256, 256, 256)
#: Timed methods: the owner as an attribute of the model, the method, the part its time counts for.
PARTS: Final = (
    ("env", "step", "simulation"),
    ("", "_sample_action", "acting and exploring"),
    ("advisor", "advise", "advice"),
    ("", "_store_transition", "storing and normalising"),
    ("replay_buffer", "sample_transitions", "drawing and relabelling"),
    ("replay_buffer", "as_samples", "drawing and relabelling"),
    ("", "_update_critic", "critics' step"),
    ("", "_update_actor", "actor's step"),
)


@dataclass(frozen=True)
class Variant:
    """Our learner with one change.

    :param name: name of the change.
    :param settings: maps the run's configuration to the fields that differ.
    :param prepare: function that changes the model.
    """

    name: str
    settings: Callable[[Any], dict[str, Any]] = lambda config: {}
    prepare: Callable[[Any], None] | None = None


def in_bfloat16(model: Any) -> None:
    """Train with torch's automatic mixed precision in bfloat16."""
    import torch

    inner = model.train

    def train(gradient_steps: int, batch_size: int) -> None:
        with torch.autocast("cpu", dtype=torch.bfloat16):
            inner(gradient_steps, batch_size)

    model.train = train


def compiled(model: Any) -> None:
    """Compile the networks' forward and backward passes."""
    import torch

    for network in (model.actor, model.actor_target, model.critic, model.critic_target):
        network.forward = torch.compile(network.forward, dynamic=False)
    model.critic.q1_forward = torch.compile(model.critic.q1_forward, dynamic=False)


VARIANTS: Final = (
    Variant(AS_CONFIGURED),
    Variant("bfloat16", prepare=in_bfloat16),
    Variant("torch.compile", prepare=compiled),
    Variant("half the batch", lambda config: {"batch_size": config.batch_size // 2}),
    Variant("half the updates", lambda config: {"gradient_steps": config.gradient_steps // 2}),
    Variant("actor every 4th update", lambda config: {"policy_delay": 4}),
    Variant("half the width", lambda config: {"net_arch": tuple(w // 2 for w in config.net_arch)}),
    Variant("no LayerNorm", lambda config: {"layer_norm": False}),
    Variant("the paper's eight layers", lambda config: {"net_arch": EIGHT_LAYERS}),
)


def settings_of(env_id: str, variant: Variant) -> Any:
    """Build the environment's run configuration with a variant's changes.

    A warm start from the teachers is replaced by their advice: the warm start takes hardly any time
    and does not work with every width.

    :param env_id: id of the environment.
    :param variant: the change.
    :return: a run's configuration.
    """
    from saver_advisors.training.defaults import default_settings
    from saver_advisors.training.settings import RunConfig

    config = RunConfig.from_mapping(default_settings(env_id))
    if config.advice is not None and config.advice.warm_start:
        advised = replace(
            config.advice, strategy="early", budget=config.total_steps, warm_start=False
        )
        config = replace(config, advice=advised)
    return replace(config, **variant.settings(config))


class Stopwatch:
    """Adds up the processor time of each watched method.

    Time that a watched method spends in another one counts for the latter only, so that the parts
    add up to the whole.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._running: list[str] = []
        self._since = 0.0

    def watch(self, owner: Any, method: str, part: str) -> None:
        """Time a method of one object from now on.

        :param owner: the object, whose attributes must be settable.
        :param method: name of the method.
        :param part: the part that its time counts for.
        :raises AttributeError: if the object has no such method.
        """
        inner = getattr(owner, method)
        self.seconds.setdefault(part, 0.0)

        @functools.wraps(inner)
        def timed(*arguments: Any, **named: Any) -> Any:
            self._lap()
            self._running.append(part)
            try:
                return inner(*arguments, **named)
            finally:
                self._lap()
                self._running.pop()

        setattr(owner, method, timed)

    def take(self) -> dict[str, float]:
        """Return the seconds of each part since the last call, and start again at 0."""
        taken = dict(self.seconds)
        self.seconds = dict.fromkeys(taken, 0.0)
        return taken

    def _lap(self) -> None:
        """Add the time since the last lap to the part that is running."""
        now = time.process_time()
        if self._running:
            self.seconds[self._running[-1]] += now - self._since
        self._since = now


class TimedLoop:
    """A learner that trains block by block: one episode in each environment, then updates.

    :param model: an SB3 algorithm with a ``train_freq`` of one episode.
    :param config: the run's configuration.
    """

    def __init__(self, model: Any, config: Any) -> None:
        self.model = model
        self.steps = config.n_envs * episode_horizon(model.get_env())
        self.updates = config.gradient_steps
        self.watch = Stopwatch()
        self._blocks = 0

    def block(self) -> dict[str, float]:
        """Train for one block.

        :return: processor seconds by part, with ``total``, and ``the rest`` for code that is not
            timed.
        """
        began = time.process_time()
        self.model.learn(self.steps, log_interval=None, reset_num_timesteps=self._blocks == 0)
        total = time.process_time() - began
        self._blocks += 1
        parts = self.watch.take()
        return {**parts, REST: total - sum(parts.values()), "total": total}


def our_loop(env_id: str, variant: Variant, by_part: bool) -> TimedLoop:
    """Build our learner in an environment, as `saver train` builds it.

    :param env_id: id of the environment.
    :param variant: the change.
    :param by_part: whether to time every part instead of the update as a whole.
    :return: the loop.
    """
    config = settings_of(env_id, variant)
    model: Any = build_model(config, build_env(config))
    if variant.prepare is not None:
        variant.prepare(model)
    loop = TimedLoop(model, config)
    for owner, method, part in PARTS if by_part else (("", "train", UPDATE),):
        watched = getattr(model, owner, None) if owner else model
        if watched is not None:
            loop.watch.watch(watched, method, part)
    return loop


def stock_loop(env_id: str, algorithm: str) -> TimedLoop:
    """Build SB3's own algorithm and hindsight replay, with our network sizes, batches and updates.

    :param env_id: id of the environment.
    :param algorithm: ``TD3`` or ``DDPG``.
    :return: the loop.
    """
    import stable_baselines3
    from stable_baselines3.common.logger import Logger

    config = settings_of(env_id, VARIANTS[0])
    env = build_env(config)
    horizon = episode_horizon(env)
    model: Any = getattr(stable_baselines3, algorithm)(
        "MultiInputPolicy",
        env,
        replay_buffer_class=stable_baselines3.HerReplayBuffer,
        policy_kwargs={"net_arch": list(config.net_arch)},
        batch_size=config.batch_size,
        buffer_size=config.buffer_size,
        # SB3's replay cannot be sampled before an episode of each environment has ended.
        learning_starts=config.n_envs * horizon,
        train_freq=(horizon, "step"),
        gradient_steps=config.gradient_steps,
        seed=0,
        device="cpu",
    )
    model.set_logger(Logger(folder=None, output_formats=[]))
    loop = TimedLoop(model, config)
    loop.watch.watch(model, "train", UPDATE)
    return loop


def evaluation_seconds(env_id: str) -> tuple[float, int]:
    """Time an evaluation of a run.

    :param env_id: id of the environment.
    :return: processor seconds of an evaluation, and the environment steps between two.
    """
    from saver_advisors.evaluation.episodes import evaluate_policy

    config = settings_of(env_id, VARIANTS[0])
    model = our_loop(env_id, VARIANTS[0], by_part=False).model
    began = time.process_time()
    evaluate_policy(
        lambda observation: model.predict(observation, deterministic=True)[0],
        env_id,
        episodes=config.eval_episodes,
        seed=config.eval_seed,
        env_kwargs=config.env_kwargs,
    )
    return time.process_time() - began, config.eval_every
