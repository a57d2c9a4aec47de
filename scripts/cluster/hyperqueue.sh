#!/bin/sh
# A study on the workers of HyperQueue, one task per shard:
#
#     hq submit --array 0-99 scripts/cluster/hyperqueue.sh STUDY 100 [OPTIONS OF study]
#
# The same command again runs what is left of it. CARTPOLE_DQN names the program where it is not in PATH.
study=$1
shards=$2
shift 2
exec "${CARTPOLE_DQN:-cartpole-dqn}" study "$study" --shard "$HQ_TASK_ID/$shards" --jobs 1 --quiet "$@"
