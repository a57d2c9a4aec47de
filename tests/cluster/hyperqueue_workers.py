"""A study on a HyperQueue with two workers, of which one task is killed; the report must be that of one process.

    pip install hyperqueue==0.27.0 && python tests/cluster/hyperqueue_workers.py --binary target/release/cartpole-dqn

The package on PyPI has the server and the workers, and not the program `hq`. So the tasks are submitted from Python, with the
script and the variable of `hq submit --array`.
"""

import argparse
import pathlib
import subprocess
import tempfile

from hyperqueue import Job, LocalCluster
from hyperqueue.cluster import WorkerConfig

SHARDS = 6
SCRIPT = pathlib.Path(__file__).resolve().parents[2] / "scripts/cluster/hyperqueue.sh"

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--binary", type=pathlib.Path, required=True, help="the cartpole-dqn to run")
binary = parser.parse_args().binary.resolve()


def run(directory, *arguments):
    subprocess.run([binary, *map(str, arguments)], cwd=directory, check=True, stdout=subprocess.DEVNULL)


def submit(client, directory):
    job = Job(directory)
    for shard in range(SHARDS):
        env = {"HQ_TASK_ID": str(shard), "CARTPOLE_DQN": str(binary)}
        job.program([str(SCRIPT), "many", str(SHARDS)], env=env, cwd=str(directory))
    return client.submit(job)


with tempfile.TemporaryDirectory() as path:
    directory = pathlib.Path(path)
    for study in ["many", "one"]:
        run(directory, "study", "--set", "budget.steps=3000", "--seeds", "0..60", "--out", study, "--plan", "--quiet")
    with LocalCluster() as cluster:
        for _ in range(2):
            cluster.start_worker(WorkerConfig(cores=1))
        client = cluster.client()
        submitted = submit(client, directory)
        # A task that dies of a signal fails, and the same submission runs what is left.
        killed = None
        while killed is None:
            found = subprocess.run(["pgrep", "-f", f"{binary} study many --shard"], capture_output=True, text=True)
            killed = next(iter(found.stdout.split()), None)
        subprocess.run(["kill", "-KILL", killed], check=True)
        failed = not client.wait_for_jobs([submitted], raise_on_error=False)
        assert failed, "the task that was killed did not fail"
        assert client.wait_for_jobs([submit(client, directory)], raise_on_error=False), "a task failed"
    run(directory, "study", "one", "--quiet")
    for study in ["many", "one"]:
        run(directory, "report", study, "--out", f"{study}-report", "--json")
    reports = [(directory / f"{study}-report/report.json").read_bytes() for study in ["many", "one"]]
    assert reports[0] == reports[1], "another report than that of one process"
    print(f"HyperQueue: {SHARDS} shards on two workers, one task killed and submitted again; the report is that of one process")
