#!/bin/sh
# A study on the workers of HyperQueue, one task per shard:
#
#     hq submit --array 0-99 scripts/cluster/hyperqueue.sh STUDY 100
#
# The same command again runs what is left of it. CARTPOLE_DQN names the program where it is not in PATH.
exec "${CARTPOLE_DQN:-cartpole-dqn}" study "$1" --shard "$HQ_TASK_ID/$2" --jobs 1 --quiet
