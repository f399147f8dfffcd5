"""Multi-agent baselines in PettingZoo's form: each arm is an agent that sees its own observation.

    python docs/examples/multi_agent.py --env DualJacoPush-v0 --output runs/sharing
    python docs/examples/multi_agent.py --env DualJacoPush-v0 --output runs/own --independent

The agents share one network, or each has its own. `saver evaluate` plays them together:

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
from saver_advisors.evaluation.protocol import training_seed
from saver_advisors.learner import GoalTD3
from saver_advisors.learner.independent import IndependentLearners
from saver_advisors.policies.files import save_policy
from saver_advisors.policies.teacher import Teacher
from saver_advisors.pretrained import side_by_side
from saver_envs.envs.agents_vec_env import AgentsVecEnv

EVALUATION_SEED = 10_000
RATES = ("success_rate", "safe_success_rate", "success_rate_2cm")


def learner(env, seed, horizon, gradient_steps):
    """Settings of zoo_configs/saver.yml, for the observation and action of one agent."""
    return GoalTD3(
        "MultiInputPolicy",
        env,
        seed=seed,
        train_freq=(horizon, "step"),  # an episode in each environment, then the gradient steps
        gradient_steps=gradient_steps,
        learning_starts=0,
        batch_size=256,
        buffer_size=600_000,
        gamma=0.98,
        tau=0.01,
        policy_delay=2,
        target_policy_noise=0.1,
        target_noise_clip=0.2,
        exploration_noise=0.15,
        random_action_probability=0.3,
        random_action_steps=8,
        contact_cost=0.5,
        policy_kwargs={"net_arch": [128, 128, 128], "layer_norm": True, "action_penalty": 0.1},
    )


class SharedParameters:
    """One model; every agent of every environment is a row of its batch."""

    def __init__(self, env, build):
        self.models, self.n_agents = {"agents": build("agents", env)}, len(env.agents)

    def learn(self, steps, **named):
        self.models["agents"].learn(steps * self.n_agents, **named)  # it counts rows


def evaluate(teachers, env_id, task, episodes):
    """Play the agents together, by the protocol of every other policy."""
    team = side_by_side(teachers, task.n_arms, task.goal_layout.shared)

    def predict(seen):
        return team.predict(seen)[0]

    return evaluate_policy(predict, env_id, episodes=episodes, seed=EVALUATION_SEED).summary()


def card(args, point, success):
    """Say where a weight file comes from."""
    return {
        "env_id": args.env,
        "algorithm": "GoalTD3",
        "command": " ".join(["python", *sys.argv]),
        **point,
        "seed": args.seed,
        "commit": "",
        "success": success,
        "success_episodes": args.episodes,
        "task": f"an agent of {args.env}",
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--env", default="DualJacoPush-v0")
    parser.add_argument("--output", type=Path, required=True, help="folder of curve and weights")
    parser.add_argument("--independent", action="store_true", help="a network for each agent")
    parser.add_argument("--steps", type=int, default=400_000, help="of the environments")
    parser.add_argument("--every", type=int, default=20_000, help="steps between evaluations")
    parser.add_argument("--episodes", type=int, default=100, help="of an evaluation")
    parser.add_argument("--n-envs", type=int, default=16)
    parser.add_argument("--gradient-steps", type=int, default=240, help="after each round")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    torch.set_num_threads(1)

    def agents():
        return make("parallel", f"saver_envs/{args.env}", own_goals=True)

    env = AgentsVecEnv([agents] * args.n_envs)
    episodes, names = env.envs[0].episodes, ["agents", *env.agents]
    seed, horizon = training_seed(args.seed), episodes.settings.horizon

    def build(name, own_env):
        return learner(own_env, seed + names.index(name), horizon, args.gradient_steps)

    learners = (IndependentLearners if args.independent else SharedParameters)(env, build)
    start, curve = time.perf_counter(), []
    for steps in range(args.every, args.steps + 1, args.every):
        learners.learn(args.every, reset_num_timesteps=False)
        teachers = {name: Teacher.from_sb3(model) for name, model in learners.models.items()}
        summary = evaluate(list(teachers.values()), args.env, episodes.task, args.episodes)
        point = {"steps": steps, "wall_clock_s": round(time.perf_counter() - start, 1)}
        curve.append(point | {name: summary[name] for name in RATES} | summary["cost_means"])
        print(json.dumps(curve[-1]), flush=True)
        for name, teacher in teachers.items():
            weights = args.output / f"{name}.safetensors"
            save_policy(weights, teacher, card(args, point, summary["success_rate"]))
        (args.output / "curve.json").write_text(json.dumps(curve, indent=1))


if __name__ == "__main__":
    main()
