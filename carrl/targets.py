"""What of CarRL a configuration may name."""

from collections.abc import Mapping

TARGETS: Mapping[str, tuple[str, ...]] = {
    "track": (
        "carrl.tracks.track.Track.load",
        "carrl.tracks.track.Track.random",
        "carrl.tracks.circuits.make_circuits",
    ),
    "vehicle": (
        "carrl.sim.vehicle.Vehicle",
        "carrl.sim.vehicle.Bicycle",
        "carrl.sim.kinematic.Kinematic",
        "carrl.sim.single_track.SingleTrack",
    ),
    "sensor": ("carrl.sim.sensor.Sensor",),
    "action": tuple(f"carrl.task.action.{name}" for name in ("DiscreteActions", "make_table", "ContinuousActions")),
    "observation": (
        *(f"carrl.task.observation.{name}" for name in ("Rays", "Scans", "LastAction")),
        *(f"carrl.task.motion.{name}" for name in ("StateEntry", "Velocity", "LastControl", "WallContact")),
        *(f"carrl.task.road.{name}" for name in ("HeadingError", "TrackPosition", "Curvatures")),
        *(f"carrl.task.traffic.{name}" for name in ("RaysOnCars", "NearestCars")),
    ),
    "reward": (
        *(f"carrl.task.reward.{name}" for name in ("Collision", "Proximity", "Gate", "Steering", "Shaping")),
        *(f"carrl.task.racing.{name}" for name in ("Progress", "Contact", "SpeedAlong", "Time")),
        *(f"carrl.task.traffic.{name}" for name in ("Overtaking", "GapGained", "CarContact")),
    ),
    "end": tuple(
        f"carrl.task.end.{name}"
        for name in (
            *("EndAtContact", "SlideAlongWall", "NoProgress", "RunningBackwards"),
            *("EndAtCarContact", "BumpIntoCars"),
        )
    ),
    "opponents": (
        "carrl.opponents.line.LineOpponents",
        "carrl.opponents.rule.RuleOpponents",
        "carrl.opponents.policy.PolicyOpponents",
    ),
    "start": ("carrl.task.episode.Start",),
    "env": ("carrl.env.track_env.TrackEnv",),
    "algorithm": (
        "carrl.algorithms.dqn.dqn.DQNRecipe",
        "carrl.algorithms.actor_critic.actor_critic.ActorCriticRecipe",
    ),
    "network": (
        "carrl.algorithms.common.network.make_q_network",
        "carrl.algorithms.common.network.make_dueling_network",
        "carrl.algorithms.common.network.make_noisy_network",
        "carrl.algorithms.common.network.make_distributional_network",
        "carrl.algorithms.actor_critic.network.make_actor_critic",
    ),
    "exploration": (
        "carrl.algorithms.dqn.policy.ExponentialEpsilonGreedy",
        "carrl.algorithms.dqn.policy.LinearEpsilonGreedy",
        "carrl.algorithms.dqn.policy.ConstantEpsilonGreedy",
        "carrl.algorithms.actor_critic.exploration.NoNoise",
        "carrl.algorithms.actor_critic.exploration.GaussianNoise",
        "carrl.algorithms.actor_critic.exploration.OrnsteinUhlenbeckNoise",
    ),
    "loss": (
        "carrl.algorithms.dqn.loss.make_dqn_loss",
        "carrl.algorithms.dqn.loss.make_cql_loss",
        "carrl.algorithms.dqn.loss.make_advantage_learning_loss",
        "carrl.algorithms.dqn.loss.make_dueling_loss",
        "carrl.algorithms.dqn.loss.make_distributional_loss",
        "carrl.algorithms.actor_critic.loss.DDPG",
        "carrl.algorithms.actor_critic.loss.TD3",
        "carrl.algorithms.actor_critic.loss.SAC",
    ),
    "returns": ("carrl.data.replay_buffer.NStepReturns",),
    "gradient_clipping": ("carrl.algorithms.common.optimizer.make_gradient_clipping",),
    "learning_rate": (
        "carrl.algorithms.common.optimizer.LinearDecay",
        "carrl.algorithms.common.optimizer.CosineDecay",
    ),
    "target_updater": (
        "carrl.algorithms.common.optimizer.make_hard_update",
        "carrl.algorithms.common.optimizer.make_soft_update",
    ),
    "optimizer": ("torch.optim.Adam",),
    "collector": ("carrl.data.collector.make_collector", "carrl.data.cluster_collector.ClusterCollector"),
    "replay_buffer": (
        "carrl.data.replay_buffer.make_replay_buffer",
        "carrl.data.replay_buffer.make_prioritized_replay_buffer",
    ),
    "recorder": ("carrl.log.writer.LogWriter",),
    "logger": (
        "carrl.train.scalars.make_tensorboard",
        "carrl.train.scalars.make_wandb",
        "carrl.train.scalars.make_mlflow",
    ),
    "trainer": ("carrl.train.plan.TrainingPlan",),
    "evaluation": ("carrl.train.plan.EvaluationPlan",),
    "data": ("carrl.train.plan.OfflinePlan",),
}
"""CarRL's own parts, by their node's name: those that `conf/` names. The first is built where a node names none.

A run's folder can come from a stranger, and what its config names is called when the run is evaluated.
"""
