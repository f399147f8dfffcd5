"""Learn from a data set without playing: behaviour cloning, then TD3+BC with hindsight goals.

    saver dataset medium --env JacoPush-v0 --episodes 300
    python docs/examples/offline_learning.py saver/JacoPush-v0/medium-v0

TD3+BC (Fujimoto and Gu, A Minimalist Approach to Offline Reinforcement Learning, arXiv 2106.06860)
adds the squared distance to the data's actions to the actor's loss, so that the actor stays where
the critic has seen data. Relabelled goals make every episode one that reached something.
"""

import argparse
from typing import Any

import minari
import numpy as np
import torch
from stable_baselines3.common.logger import Logger
from torch.nn import functional

from saver_advisors.evaluation.episodes import evaluate_policy
from saver_advisors.learner import GoalTD3
from saver_advisors.learner.imitation import clone
from saver_envs.envs.sb3_vec_env import SaverVecEnv

BATCH_SIZE, LEARNING_RATE = 256, 1e-3
EVALUATION_SEED = 0  # the seeds of data sets begin at 1,000,000


class OfflineTD3BC(GoalTD3):
    """TD3 whose actor also imitates the actions of the data."""

    alpha = 2.5  # weight of the value relative to the imitation

    def _update_actor(self, batch: Any, advised: torch.Tensor) -> tuple[float, float]:
        actions = self.actor(batch.observations)
        values = self.critic.q1_forward(batch.observations, actions)
        imitation = functional.mse_loss(actions, batch.actions)
        loss = imitation - self.alpha * values.mean() / values.detach().abs().mean()
        self.actor.optimizer.zero_grad()
        loss.backward()
        self.actor.optimizer.step()
        return loss.item(), imitation.item()


def learner_of(dataset: minari.MinariDataset, width: int) -> tuple[OfflineTD3BC, str, dict]:
    """Return a learner whose replay buffer holds the data set, and its environment."""
    spec = dataset.spec.env_spec
    options = {**spec.kwargs, "max_episode_steps": spec.max_episode_steps}
    env_id = options.pop("env_id")
    model = OfflineTD3BC(
        "MultiInputPolicy",
        SaverVecEnv(env_id, n_envs=1, seed=0, **options),
        # Each episode has room for the longest one, and the last is never replaced.
        buffer_size=(dataset.total_episodes + 1) * spec.max_episode_steps,
        policy_kwargs={"net_arch": [width] * 3},
        learning_rate=LEARNING_RATE,
        gamma=0.98,
        seed=0,
        device="cpu",
    )
    model.set_logger(Logger(folder=None, output_formats=[]))
    for episode in dataset.iterate_episodes():
        add_episode(model, episode)
    return model, env_id, options


def add_episode(model: OfflineTD3BC, episode: minari.EpisodeData) -> None:
    """Store an episode, and count it in the statistics that normalise observations."""
    last = len(episode.rewards) - 1
    for step, action in enumerate(episode.actions):
        seen, then = (
            {key: rows[None, row] for key, rows in episode.observations.items()}
            for row in (step, step + 1)
        )
        model.replay_buffer.add(
            seen, then, action[None], episode.rewards[step], np.array([step == last]), [{}]
        )
    model.policy.shared_features.update(model.replay_buffer.episodes_of(np.array([0])))


def main() -> None:
    """Learn, and print success rates."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("dataset", help="id of a data set of Minari")
    parser.add_argument("--updates", type=int, default=20_000, help="of each algorithm")
    parser.add_argument("--width", type=int, default=256, help="of the hidden layers")
    parser.add_argument("--episodes", type=int, default=200, help="of each evaluation")
    args = parser.parse_args()

    model, env_id, options = learner_of(minari.load_dataset(args.dataset), args.width)

    def success_rate() -> float:
        outcomes = evaluate_policy(
            lambda seen: model.predict(seen, deterministic=True)[0],
            env_id,
            episodes=args.episodes,
            seed=EVALUATION_SEED,
            env_kwargs=options,
        )
        return outcomes.success_rate

    data = model.replay_buffer
    print(f"data: {data.size():,} steps of {len(data.ended_slots()):,} episodes")
    clone(model, data, updates=args.updates, batch_size=BATCH_SIZE, learning_rate=LEARNING_RATE)
    print(f"behaviour cloning: success {success_rate():.3f}")
    model.train(args.updates, BATCH_SIZE)
    print(f"TD3+BC: success {success_rate():.3f}")


if __name__ == "__main__":
    main()
