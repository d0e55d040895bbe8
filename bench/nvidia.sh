#!/usr/bin/env bash
# The tests and the benchmark on an NVIDIA GPU, on a machine without a network.
#
#   bench/nvidia.sh pack      with a network: wheels for this python into bench/wheels/
#   bench/nvidia.sh quick     what comes first on a card: ten minutes with 16 cores
#   bench/nvidia.sh           every test, drawn settings, endurance and the benchmark: an hour and more
#
# Results go to the folder $OUT. It needs python3 with venv, or a python3 that has the packages
# already, and the driver's libnvidia-opencl.so.1; no root rights, no OpenCL loader, no .icd file:
# pyopencl's wheel brings the loader, and this script writes the file. LIBRARY and DEVICE select
# another implementation: LIBRARY=libpocl.so.2 DEVICE=cpu bench/nvidia.sh quick
set -euo pipefail
cd "$(dirname "$0")/.."

python=${PYTHON:-python3}
device=${DEVICE:-nvidia}
if [ "${1:-}" = pack ]; then
    # PoCL is left out, so that only the GPU is found.
    "$python" -m pip download --only-binary :all: --dest bench/wheels hatchling editables wheel \
        ".[test]"
    exit
fi

out=$(mkdir -p "${OUT:-bench/results/nvidia}" && cd "${OUT:-bench/results/nvidia}" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
if "$python" -c "import cv2, hypothesis, pyopencl, xdist" 2> "$work/missing"; then
    export PYTHONPATH="$PWD${PYTHONPATH:+:$PYTHONPATH}"
else
    "$python" -m venv "$work/venv"
    . "$work/venv/bin/activate"
    python=python
    pip install --quiet --no-index --find-links bench/wheels hatchling editables
    pip install --quiet --no-index --find-links bench/wheels --no-build-isolation -e ".[test]"
fi
echo "${LIBRARY:-libnvidia-opencl.so.1}" > "$work/only.icd"
export OCL_ICD_VENDORS="$work/only.icd" XDG_CACHE_HOME="$work" CMP_CL_DEVICE=$device

failed=()
step() {
    local name=$1
    shift
    echo "== $name: $*"
    local start=$SECONDS
    "$@" 2>&1 | tee "$out/$name.txt" || failed+=("$name")
    echo "== $name: $((SECONDS - start)) s"
}
tests() { step tests "$python" -m pytest -n "$(nproc)" --durations 20 "$@"; }

[ "$device" != nvidia ] || nvidia-smi | tee "$out/nvidia-smi.txt"
step devices "$python" -m cmp_cl devices
if [ "${1:-}" = quick ]; then
    tests tests/lattice tests/motion tests/kernels tests/grid tests/test_measure.py \
        tests/test_portability.py
    for part in field speed; do
        step $part "$python" bench/$part.py --quick --out "$out"
    done
else
    tests
    step exhaustive "$python" -m pytest -m exhaustive tests/test_properties.py
    step endurance "$python" bench/endurance.py --minutes 3
    for part in field speed report; do
        step $part "$python" bench/$part.py --out "$out"
    done
fi
if [ ${#failed[@]} -gt 0 ]; then
    echo "FAILED: ${failed[*]}"
    exit 1
fi
echo "All passed; results in $out"
