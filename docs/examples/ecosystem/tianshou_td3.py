"""Tianshou: a few hundred steps of its collector and of TD3's update."""

import gymnasium
import numpy as np
from tianshou.algorithm import TD3
from tianshou.algorithm.modelfree.ddpg import ContinuousDeterministicPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.trainer import OffPolicyTrainerParams
from tianshou.utils.net.common import Net
from tianshou.utils.net.continuous import ContinuousActorDeterministic, ContinuousCritic


def make():
    return gymnasium.wrappers.FlattenObservation(gymnasium.make("saver_envs:JacoPushDense-v0"))


env = make()
envs, test_envs = DummyVectorEnv([make] * 4), DummyVectorEnv([make] * 2)
state, action = env.observation_space.shape, env.action_space.shape
actor = ContinuousActorDeterministic(
    preprocess_net=Net(state_shape=state, hidden_sizes=[64]), action_shape=action, max_action=1.0
)
critics = [
    ContinuousCritic(
        preprocess_net=Net(state_shape=state, action_shape=action, hidden_sizes=[64], concat=True)
    )
    for _ in range(2)
]
algorithm = TD3(
    policy=ContinuousDeterministicPolicy(actor=actor, action_space=env.action_space),
    policy_optim=AdamOptimizerFactory(lr=1e-3),
    critic=critics[0],
    critic_optim=AdamOptimizerFactory(lr=1e-3),
    critic2=critics[1],
    critic2_optim=AdamOptimizerFactory(lr=1e-3),
)
result = algorithm.run_training(
    OffPolicyTrainerParams(
        training_collector=Collector(algorithm, envs, VectorReplayBuffer(2_000, 4)),
        test_collector=Collector(algorithm, test_envs),
        max_epochs=1,
        epoch_num_steps=400,
        collection_step_num_env_steps=40,
        update_step_num_gradient_steps_per_sample=0.25,
        test_step_num_episodes=2,
        batch_size=64,
    )
)
print("mean return", np.round(result.best_reward, 1))
