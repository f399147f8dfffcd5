"""DAgger: an actor imitates its teachers in the states that it visits itself.

Behaviour cloning learns from the teachers' episodes alone. A student that deviates a little reaches
states that no teacher visits, where it has learned nothing. DAgger (Ross, Gordon and Bagnell, arXiv
1011.0686) lets the student act and asks the teachers at every step what they would do.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import torch as th

from saver_advisors.learner.algorithms import GoalTD3
from saver_advisors.learner.imitation import LABEL_LOSS, fit


class GoalDAgger(GoalTD3):
    """Fit the actor to the labels in the replay buffer: the teachers' actions in stored states.

    An advisor with the strategy ``dagger`` gives the labels. The critics are not trained.

    :param arguments: as for ``GoalTD3``.
    """

    learns_values: ClassVar[bool] = False

    def _setup_model(self) -> None:
        self.replay_buffer_kwargs.setdefault("labels", True)
        super()._setup_model()
        # Readers of the weights see that these critics know nothing.
        self.policy.critic.register_buffer("untrained", th.ones(()))

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        """Perform gradient steps of the actor, unless no step has a label yet.

        :param gradient_steps: actor updates.
        :param batch_size: transitions per update.
        """
        self.policy.set_training_mode(True)
        self._update_learning_rate([self.actor.optimizer])
        losses = []
        for _ in range(gradient_steps if self.replay_buffer.size() > 0 else 0):
            drawn = self.replay_buffer.sample_transitions(batch_size)
            seen, wanted = self.replay_buffer.labelled(drawn)
            if len(wanted):
                losses.append(fit(self.actor, self.actor.optimizer, seen, wanted, LABEL_LOSS))
        self._n_updates += len(losses)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        if losses:
            self.logger.record("train/actor_loss", np.mean(losses))
