#!/usr/bin/env bash
# tests/cluster/slurm.sh BINARY: a study as a job array of a Slurm with one node, which this script starts and stops. One task
# gets SIGTERM as before its time limit, one is killed and requeued. Then a study on a program: Slurm signals the programs too,
# once with SIGTERM as before a time limit and once by a plain scancel. Needs a C compiler, Debian's slurmctld, slurmd, slurm-client and munge,
# and root. No systemd is needed: the daemons get their directories from a slurm.conf of their own.
set -euo pipefail
binary=$(realpath "${1:?the program}")
script=$(realpath "$(dirname "$0")/../../scripts/cluster/slurm.sbatch")
example=$(realpath "$(dirname "$0")/../../adapters/example.c")
tmp=$(mktemp -d)
host=$(hostname -s)
stop() {
    for file in slurmd.pid slurmctld.pid munge/pid; do
        [ -s "$tmp/$file" ] || continue
        pid=$(cat "$tmp/$file")
        kill "$pid" 2>/dev/null || true
        timeout 20 sh -c "while kill -0 $pid 2>/dev/null; do sleep 0.1; done" || true
    done
    rm -rf "$tmp"
}
trap stop EXIT
cd "$tmp"
fail() { printf 'FAILED: %s\n%s\n' "$*" "$(tail -n 20 slurmctld.log slurmd.log slurm-*.out 2>/dev/null)" >&2; exit 1; }

mkdir -m 700 munge state spool
head -c 1024 /dev/urandom >munge/key
chmod 600 munge/key
munged --force --key-file="$tmp/munge/key" --socket="$tmp/munge/socket" --pid-file="$tmp/munge/pid" \
    --log-file="$tmp/munge/log" --seed-file="$tmp/munge/seed"
# A task that is requeued waits until its credential has expired, which takes two minutes by default.
cat >slurm.conf <<CONF
ClusterName=one
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
SlurmctldPort=16817
SlurmdPort=16818
AuthType=auth/munge
AuthInfo=socket=$tmp/munge/socket,cred_expire=5
StateSaveLocation=$tmp/state
SlurmdSpoolDir=$tmp/spool
SlurmctldPidFile=$tmp/slurmctld.pid
SlurmdPidFile=$tmp/slurmd.pid
SlurmctldLogFile=$tmp/slurmctld.log
SlurmdLogFile=$tmp/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=sched_interval=1,bf_interval=1
KillWait=5
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(nproc) State=UNKNOWN
PartitionName=main Nodes=$host Default=YES State=UP
CONF
export SLURM_CONF=$tmp/slurm.conf CARTPOLE_DQN=$binary
slurmctld -f "$SLURM_CONF"
slurmd -f "$SLURM_CONF"
timeout 60 sh -c 'until sinfo --noheader --format %t | grep -q idle; do sleep 0.2; done' || fail 'the node does not come up'

plan() { "$binary" study --set budget.steps=15000 --seeds 0..640 --out "$1" --plan --quiet; }
plan slurm
plan one
job=$(sbatch --parsable --array=0-3 "$script" slurm 4)
timeout 120 sh -c "until squeue --noheader --states R --job $job | grep -q .; do sleep 0.1; done" || fail 'no task starts'
running() { squeue --noheader --states R --array --job "$job" --format %K | head -n 1; }
first=$(running)
sleep 1
scancel --signal=TERM "${job}_$first"
timeout 120 sh -c "until squeue --noheader --states R --array --job $job --format %K | grep -qv '^$first\$'; do sleep 0.1; done" ||
    fail 'no other task starts'
second=$(squeue --noheader --states R --array --job "$job" --format %K | grep -v "^$first\$" | head -n 1)
scontrol requeue "${job}_$second"
timeout 400 sh -c "while squeue --noheader --job $job 2>/dev/null | grep -q .; do sleep 1; done" || fail 'the array does not end'
for task in "$first" "$second"; do
    scontrol show job "${job}_$task" | grep -q 'Restarts=[1-9]' || fail "task $task was not requeued"
done
"$binary" study slurm --status
"$binary" study one --quiet
for study in slurm one; do "$binary" report "$study" --out "$study-report" --json >/dev/null; done
cmp one-report/report.json slurm-report/report.json || fail 'another report than that of one process'

cc -O2 -ffp-contract=off -o dock "$example" -lm
programs=(--set 'environment={"command":["./dock"]}' --set observation_divisors=null --set replay.mirror=false
    --set optimizer.schedule=null --set budget.steps=12000 --set checkpoint.every_steps=1000 --seeds 0..12)
for study in slurm-dock one-dock; do "$binary" study "${programs[@]}" --out "$study" --plan --quiet; done
wait_for() { timeout 240 sh -c "until $1; do sleep 0.1; done" || fail "$2"; }
submit() { sbatch --parsable --array=0-1 "$script" slurm-dock 2 --allow-command; }
is_training='[ -n "$(ls slurm-dock/unfinished/*.safetensors 2>/dev/null)" ]'
job=$(submit)
wait_for "$is_training" 'no trial on a program begins'
task=$(running)
scancel --signal=TERM "${job}_$task"
wait_for "scontrol show job ${job}_$task | grep -q 'Restarts=[1-9]'" "task $task on a program was not requeued"
wait_for "squeue --noheader --states R --job $job | grep -q ." 'no task on a program runs again'
wait_for "$is_training" 'no trial on a program begins again'
scancel "$job"
wait_for "! squeue --noheader --job $job | grep -q ." 'the array on a program does not end'
! grep -h '"error":"' slurm-dock/trials/*.jsonl || fail 'a line records that a program got a signal'
"$binary" study slurm-dock --status | tee status
grep -q 'ended without a result' status || fail 'the status does not say why the last tries ended'
job=$(submit)
wait_for "! squeue --noheader --job $job | grep -q ." 'the second array on a program does not end'
"$binary" study one-dock --quiet --allow-command
for study in slurm-dock one-dock; do "$binary" report "$study" --out "$study-report" --json >/dev/null; done
cmp one-dock-report/report.json slurm-dock-report/report.json || fail 'another report on a program than that of one process'
echo "Slurm: task $first got SIGTERM and requeued itself, task $second was killed and requeued; the report is that of one process"
echo "Slurm: on a program, task $task got SIGTERM with its programs and requeued itself, then scancel ended the array; the report is that of one process"
