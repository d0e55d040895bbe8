#!/usr/bin/env bash
# The tests and the benchmark on an NVIDIA GPU, on a machine without a network.
#
#   bench/nvidia.sh pack      with a network: wheels for this python into bench/wheels/
#   bench/nvidia.sh           on the machine with the GPU; results go to the folder $OUT
#   bench/nvidia.sh quick     the same commands with small numbers, to check that they work
#
# It needs python3 with venv, or a python3 that has the packages already, and the driver's
# libnvidia-opencl.so.1. It needs no root rights, no OpenCL loader and no .icd file: pyopencl's
# wheel brings the loader, and this script writes the file. LIBRARY and DEVICE select another
# implementation:
# LIBRARY=libpocl.so.2 DEVICE=cpu bench/nvidia.sh quick
set -euo pipefail
cd "$(dirname "$0")/.."

python=${PYTHON:-python3}
library=${LIBRARY:-libnvidia-opencl.so.1}
device=${DEVICE:-nvidia}

if [ "${1:-}" = pack ]; then
    # PoCL is left out, so that only the GPU is found.
    "$python" -m pip download --only-binary :all: --dest bench/wheels hatchling editables wheel \
        ".[test]"
    exit
fi

tests=tests images=5000 configs=50 minutes=3 openings=1000 scaling=
if [ "${1:-}" = quick ]; then
    tests="tests/test_portability.py"
    images=100 configs=4 minutes=0.2 openings=20 scaling=--quick
fi

out=$(mkdir -p "${OUT:-bench/results/nvidia}" && cd "${OUT:-bench/results/nvidia}" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
if "$python" -c "import cv2, hypothesis, platformdirs, pyopencl, xdist" 2> "$work/missing"; then
    export PYTHONPATH="$PWD${PYTHONPATH:+:$PYTHONPATH}"
else
    "$python" -m venv "$work/venv"
    . "$work/venv/bin/activate"
    python=python
    pip install --quiet --no-index --find-links bench/wheels hatchling editables
    pip install --quiet --no-index --find-links bench/wheels --no-build-isolation -e ".[test]"
fi

echo "$library" > "$work/only.icd"
export OCL_ICD_VENDORS="$work/only.icd" XDG_CACHE_HOME="$work" CMP_CL_DEVICE=$device

failed=()
step() {
    local name=$1
    shift
    echo "== $name: $*"
    "$@" 2>&1 | tee "$out/$name.txt" || failed+=("$name")
}

[ "$device" != nvidia ] || nvidia-smi | tee "$out/nvidia-smi.txt"
step devices "$python" -m cmp_cl devices
# shellcheck disable=SC2086
step tests "$python" -m pytest -n "$(nproc)" --durations 20 $tests
step fuzz "$python" tests/fuzz.py --images $images --configs $configs
step endurance "$python" bench/endurance.py --minutes $minutes --openings $openings \
    --json "$out/endurance.json"
# Sizes, one VGA frame after another, batches of up to 256 frames, the time of each kernel.
# shellcheck disable=SC2086
step scaling "$python" bench/scaling.py --device "$device" $scaling --out "$out"
step speed "$python" bench/speed.py --quick --out "$out"
step report "$python" bench/report.py --out "$out"
if [ ${#failed[@]} -gt 0 ]; then
    echo "FAILED: ${failed[*]}"
    exit 1
fi
echo "All passed; results in $out"
