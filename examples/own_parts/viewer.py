"""Draws what each step of a log's first episode earned: python viewer.py RUN/train.mcap."""

import sys

import carrl.log

rewards = carrl.log.load(sys.argv[1], episodes=[0])["next", "reward"].flatten().tolist()
for step, reward in enumerate(rewards):
    print(f"{step:4d} {reward:7.1f} {'#' * min(round(abs(reward)), 60)}")
