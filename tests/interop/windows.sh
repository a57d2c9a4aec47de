#!/usr/bin/env bash
# Builds the program for Windows with MinGW, runs it under wine, and requires the bytes of the Linux build, with the CPU's fast
# kernels and with the scalar ones. Ends with a table of what was tried. Needs Debian's gcc-mingw-w64-x86-64, wine, wine64 and
# python3.
#     tests/interop/windows.sh [EXE LINUX_BINARY]      # those, in place of new release builds
set -euo pipefail
cd "$(dirname "$0")/../.."
repository=$PWD
target=x86_64-pc-windows-gnu
work=${WORK:-$(mktemp -d)}
mkdir -p "$work/bin" "$work/linux" "$work/windows"

for tool in x86_64-w64-mingw32-gcc wine python3; do
    command -v "$tool" > /dev/null || {
        echo "error: $tool is missing; on Debian: apt-get install gcc-mingw-w64-x86-64 wine wine64 python3" >&2
        exit 1
    }
done
if [ $# = 2 ]; then
    exe=$(realpath "$1") linux=$(realpath "$2")
else
    rustup target add "$target"
    cargo build --release --locked --target "$target"
    cargo build --release --locked
    exe=${CARGO_TARGET_DIR:-target}/$target/release/cartpole-dqn.exe
    linux=$(realpath "${CARGO_TARGET_DIR:-target}/release/cartpole-dqn")
fi
cp "$exe" "$work/bin/cartpole-dqn.exe"
# wine 8 lacks this library, which every Windows since 8 has.
x86_64-w64-mingw32-gcc -shared -o "$work/bin/bcryptprimitives.dll" tests/interop/windows/bcryptprimitives.c -ladvapi32

export WINEPREFIX=${WINEPREFIX:-$work/wine} WINEDEBUG=-all WINEDLLOVERRIDES='mscoree,mshtml='
wineboot --init > "$work/wineboot.log" 2>&1
trap 'wineserver --kill || true' EXIT
windows() { wine "$work/bin/cartpole-dqn.exe" "$@"; }
linux() { "$linux" "$@"; }
# Both systems see the same names in the same current directory.
both() {
    (cd "$work/linux" && linux "$@")
    (cd "$work/windows" && windows "$@")
}
same() { for path in "$@"; do diff --recursive --brief "$work/linux/$path" "$work/windows/$path"; done; }
# A page names its checkpoint, with a backslash on Windows.
same_page() { sed 's|checkpoints\\\\|checkpoints/|g' "$work/windows/$1" | diff --brief "$work/linux/$1" -; }
same_run() {
    local run=$1
    same "$run/metrics.jsonl" "$run/config.json" "$run/checkpoints"
    grep --quiet "$(grep -o '"weights_sha256": *"[0-9a-f]*"' "$work/linux/$run/summary.json")" "$work/windows/$run/summary.json"
}
# A run of several seconds.
long=(train --config "$repository/configs/smoke.json" --set 'network.hidden=[256,256]' --set checkpoint.every_steps=500 --quiet)
# Trains in the background until the run is well under way; `pid` is its process.
start() {
    (cd "$work/windows" && exec wine "$work/bin/cartpole-dqn.exe" "${long[@]}" --set "budget.steps=$2" --out "$1") \
        > "$work/started.log" 2>&1 &
    pid=$!
    for _ in $(seq 600); do
        [ ! -s "$work/windows/$1/checkpoints/last.safetensors" ] || return 0
        sleep 0.1
    done
    echo "no checkpoint in a minute: $(cat "$work/started.log")" >&2
    return 1
}
stop() { kill -KILL "$pid" && wait "$pid" 2> /dev/null || true; }

rows=()
failed=0
# One row of the table: a name, and a function that must succeed.
try() {
    local name=$1 log=$work/$2.log seconds=$SECONDS
    # A subshell of its own, because `set -e` does not hold below `if`.
    set +e
    (set -e; "$2") > "$log" 2>&1
    local status=$?
    set -e
    if [ $status = 0 ]; then
        rows+=("passed  $name ($((SECONDS - seconds)) s)$([ ! -e "$work/note" ] || echo ": $(cat "$work/note")")")
    else
        rows+=("FAILED  $name: $log")
        failed=1
    fi
    rm -f "$work/note"
    echo "${rows[-1]}"
}

smoke_and_hash() {
    both train --config "$repository/configs/smoke.json" --quiet --out "$1"
    same_run "$1"
    local expected
    expected=$(cat "$repository/tests/data/smoke_weights.sha256")
    grep "\"weights_sha256\": *\"$expected\"" "$work/windows/$1/summary.json"
    echo "$expected, $(grep -o '"cpu_path": *"[^"]*"' "$work/windows/$1/summary.json")" > "$work/note"
}
train_fast() { smoke_and_hash fast; }
train_scalar() { CARTPOLE_DQN_SIMD=scalar smoke_and_hash scalar; }
force() {
    both train --config "$repository/configs/smoke.json" --quiet --seed 7 --out replaced
    both train --config "$repository/configs/smoke.json" --quiet --force --out replaced
    same_run replaced
}
other_tasks() {
    for task in acrobot mountain_car; do
        CARTPOLE_DQN_SIMD=scalar both train --config "$repository/configs/$task.json" --set budget.steps=3000 --quiet --out "$task"
        same_run "$task"
    done
}
eval_() {
    both eval fast --episodes 20 --trace trace.jsonl --json > "$work/evaluations"
    same trace.jsonl
}
study() {
    both study --config "$repository/configs/smoke.json" --seeds 0..4 --jobs 2 --set budget.steps=1000 --out study
    both report study --json > "$work/reports"
    both report study --out study-report
    same study-report
}
report() {
    both report fast --html fast.html
    same_page fast.html
}
runs() {
    cd "$work/windows"
    windows runs . > "$work/runs.txt"
    grep fast "$work/runs.txt"
}
verify() {
    cd "$work/windows"
    windows verify fast
    CARTPOLE_DQN_SIMD=scalar windows verify fast
}
watch() {
    cd "$work/windows"
    python3 "$repository/tests/interop/windows/keys.py" q - wine "$work/bin/cartpole-dqn.exe" watch fast
}
ctrl_c() {
    cd "$work/windows"
    local status=0
    python3 "$repository/tests/interop/windows/keys.py" $'\x03' stopped/checkpoints/last.safetensors \
        wine "$work/bin/cartpole-dqn.exe" "${long[@]}" --set budget.steps=8000 --out stopped || status=$?
    [ $status = 130 ]
    [ ! -e stopped/summary.json ]
    windows train --resume stopped --quiet
    cd "$work/linux"
    linux "${long[@]}" --set budget.steps=8000 --out stopped
    same_run stopped
}
kill_and_resume() {
    start killed 8000
    stop
    cd "$work/windows"
    [ ! -e killed/summary.json ]
    windows train --resume killed --quiet
    cd "$work/linux"
    linux "${long[@]}" --set budget.steps=8000 --out killed
    same_run killed
}
refused() {
    local status=0
    windows "$@" 2> refusal || status=$?
    cat refusal
    [ $status = 2 ]
    grep 'in use by another process' refusal
}
running() {
    start running 1000000
    trap stop EXIT
    cd "$work/windows"
    refused train --config "$repository/configs/smoke.json" --quiet --force --out running
    refused train --resume running --quiet
    refused verify running
    windows report running
    windows report running --html running.html
    windows runs . | grep running
    windows eval running --episodes 2
}
paths() {
    both train --config "$repository/configs/smoke.json" --quiet --out 'Läufe mit Leerzeichen/größter Ümlaut 学'
    same_run 'Läufe mit Leerzeichen/größter Ümlaut 学'
    both eval 'Läufe mit Leerzeichen/größter Ümlaut 学' --episodes 3 > "$work/evaluations"
    both report 'Läufe mit Leerzeichen/größter Ümlaut 学' --html 'Bericht über alles.html'
    same_page 'Bericht über alles.html'
}
programs() {
    cd "$work/windows"
    local status=0
    windows train --set 'environment.command=["python","env.py"]' --out program 2> refusal || status=$?
    cat refusal
    [ $status != 0 ]
    [ "$(wc -l < refusal)" = 1 ]
    grep 'not on Windows' refusal
    [ ! -e program ]
}

try 'train, fast kernels: the recorded weights, every byte' train_fast
try 'train, scalar kernels: the recorded weights, every byte' train_scalar
try 'train: Acrobot and MountainCar, scalar kernels, every byte' other_tasks
try 'train --force over another run' force
try 'eval: every step of its trace' eval_
try 'study --jobs 2 and its report: every byte' study
try 'report --html: every byte' report
try 'runs' runs
try 'verify, with fast and scalar kernels' verify
try 'watch, in a console, left with q' watch
try 'Ctrl-C leaves a checkpoint and exit code 130; resumed: every byte' ctrl_c
try 'killed and resumed: every byte' kill_and_resume
try 'a running run: report, runs and eval read it, train and verify are refused' running
try 'paths with spaces, umlauts and Chinese' paths
try 'a program as environment is refused in one sentence' programs

printf '\n%s, %s\n' "$(wine --version)" "$(windows --version)"
printf '%s\n' "${rows[@]}"
exit $failed
