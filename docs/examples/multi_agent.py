"""Multi-agent baselines in the PettingZoo form: every arm is an agent that sees nothing of the others.

    python docs/examples/multi_agent.py --env DualJacoPush-v0 --output runs/sharing
    python docs/examples/multi_agent.py --env DualJacoPush-v0 --output runs/independent --independent

The agents share one network, or each learns its own. `saver evaluate` plays them together:

    saver evaluate --env DualJacoPush-v0 --policy side-by-side:runs/sharing/agents.safetensors
"""

import argparse
import json
import sys
import time
from pathlib import Path

import torch
from pettingzoo import make

import saver_envs  # noqa: F401  (registers the ids)
from saver_advisors.evaluation.episodes import evaluate_policy
from saver_advisors.evaluation.protocol import SELECTION_SEED, training_seed
from saver_advisors.learner import GoalTD3
from saver_advisors.learner.independent import IndependentLearners
from saver_advisors.policies.files import save_policy
from saver_advisors.policies.teacher import Teacher
from saver_advisors.pretrained import side_by_side
from saver_envs.envs.agents_vec_env import AgentsVecEnv
from saver_envs.registration import make_episodes

RATES = ("success_rate", "safe_success_rate", "success_rate_2cm")


def learner(env, seed, horizon, **changed):
    """The settings of zoo_configs/shared_arms.yml, for one agent's observation and action."""
    arguments = {
        "train_freq": (horizon, "step"),
        "learning_starts": 0,
        "gradient_steps": 240,
        "batch_size": 256,
        "buffer_size": 600_000,
        "learning_rate": 1e-3,
        "gamma": 0.98,
        "tau": 0.01,
        "policy_delay": 2,
        "target_policy_noise": 0.1,
        "target_noise_clip": 0.2,
        "exploration_noise": 0.15,
        "random_action_probability": 0.3,
        "random_action_steps": 8,
        "contact_cost": 0.5,
        "policy_kwargs": {"net_arch": [128, 128, 128], "layer_norm": True, "action_penalty": 0.1},
    }
    return GoalTD3("MultiInputPolicy", env, seed=seed, **(arguments | changed))


class SharedParameters:
    """One model; every agent of every environment is a row of its batch."""

    def __init__(self, env, build):
        self.model, self.n_agents = build("agents", env), len(env.agents)
        self.models = {"agents": self.model}

    def learn(self, steps, **named):
        self.model.learn(steps * self.n_agents, **named)  # it counts rows

    def steps(self):
        return self.model.num_timesteps // self.n_agents


class OwnParameters(IndependentLearners):
    """A model for each agent."""

    def steps(self):
        return next(iter(self.models.values())).num_timesteps


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--env", default="DualJacoPush-v0")
    parser.add_argument("--output", type=Path, required=True, help="folder of curve and weights")
    parser.add_argument("--independent", action="store_true", help="a network for each agent")
    parser.add_argument("--steps", type=int, default=400_000, help="of the environments")
    parser.add_argument("--every", type=int, default=20_000, help="steps between evaluations")
    parser.add_argument("--episodes", type=int, default=100, help="of an evaluation")
    parser.add_argument("--n-envs", type=int, default=16)
    parser.add_argument("--gradient-steps", type=int, default=240, help="after each block")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    torch.set_num_threads(1)

    def agents():
        return make("parallel", f"saver_envs/{args.env}", own_goals=True)

    env = AgentsVecEnv([agents] * args.n_envs)
    horizon = env.envs[0].episodes.settings.horizon
    names = [*env.agents, "agents"]

    def build(agent, own_env):
        seed = training_seed(args.seed) + names.index(agent)
        return learner(own_env, seed, horizon, gradient_steps=args.gradient_steps)

    kind = OwnParameters if args.independent else SharedParameters
    learners, start, curve = kind(env, build), time.perf_counter(), []
    env.seed(training_seed(args.seed))
    while not curve or curve[-1]["steps"] < args.steps:
        learners.learn(args.every, reset_num_timesteps=False)
        teachers = {name: Teacher.from_sb3(model) for name, model in learners.models.items()}
        summary = evaluate(teachers.values(), args.env, args.episodes)
        point = {"steps": learners.steps(), "wall_clock_s": round(time.perf_counter() - start, 1)}
        curve.append(point | {name: summary[name] for name in RATES} | summary["cost_means"])
        print(json.dumps(curve[-1]), flush=True)
        for name, teacher in teachers.items():
            save_policy(args.output / f"{name}.safetensors", teacher, card(args, point, summary))
        (args.output / "curve.json").write_text(json.dumps(curve, indent=1))


def evaluate(teachers, env_id, episodes):
    """Play the agents together, by the protocol of every other policy."""
    team = side_by_side(list(teachers), make_episodes(env_id).task.n_arms)

    def predict(seen):
        return team.predict(seen)[0]

    return evaluate_policy(predict, env_id, episodes=episodes, seed=SELECTION_SEED).summary()


def card(args, point, summary):
    return {
        "env_id": args.env,
        "algorithm": "GoalTD3",
        "command": " ".join(["python", *sys.argv]),
        **point,
        "seed": args.seed,
        "commit": "",
        "success": summary["success_rate"],
        "success_episodes": args.episodes,
        "task": f"an agent of {args.env}",
    }


if __name__ == "__main__":
    main()
