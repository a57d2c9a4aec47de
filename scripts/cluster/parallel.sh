#!/bin/sh
# A study with GNU parallel: on the cores of this machine, or with `--sshloginfile FILE` on those of others that share its
# directory.
#
#     scripts/cluster/parallel.sh STUDY 100 [OPTIONS OF PARALLEL]
#
# The same command again runs what is left of it. CARTPOLE_DQN names the program where it is not in PATH.
study=$1
shards=$2
shift 2
seq 0 $((shards - 1)) | parallel "$@" "${CARTPOLE_DQN:-cartpole-dqn}" study "$study" --shard "{}/$shards" --jobs 1 --quiet
