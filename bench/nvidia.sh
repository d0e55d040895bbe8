#!/usr/bin/env bash
# The tests and the benchmark on an NVIDIA card, on a machine that reaches no network.
#
#   bench/nvidia.sh pack      with a network: wheels for this python into bench/wheels/
#   bench/nvidia.sh           on the machine with the card; results go to the folder $OUT
#
# Needs python3 with venv, and the driver's libnvidia-opencl.so.1; no rights, no OpenCL loader
# and no .icd file: pyopencl's wheel brings the one, this script writes the other.
set -euo pipefail
cd "$(dirname "$0")/.."

python=${PYTHON:-python3}
out=$(mkdir -p "${OUT:-bench/results/nvidia}" && cd "${OUT:-bench/results/nvidia}" && pwd)

if [ "${1:-}" = pack ]; then
    # PoCL is left out: nothing but the card is to be found.
    $python -m pip download --only-binary :all: --dest bench/wheels hatchling editables wheel \
        ".[test]"
    exit
fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
$python -m venv "$work/venv"
. "$work/venv/bin/activate"
pip install --quiet --no-index --find-links bench/wheels hatchling editables
pip install --quiet --no-index --find-links bench/wheels --no-build-isolation -e ".[test]"

echo libnvidia-opencl.so.1 > "$work/nvidia.icd"
export OCL_ICD_VENDORS="$work/nvidia.icd" XDG_CACHE_HOME="$work" CMP_CL_DEVICE=nvidia

nvidia-smi | tee "$out/nvidia-smi.txt"
cmp-cl devices | tee "$out/devices.txt"
status=0
python -m pytest -n 2 --durations 20 2>&1 | tee "$out/tests.txt" || status=1
python tests/fuzz.py --images 5000 --configs 50 2>&1 | tee "$out/fuzz.txt" || status=1
python bench/endurance.py --minutes 3 --json "$out/endurance.json" || status=1
python bench/speed.py --quick --out "$out/speed.json" || status=1
exit $status
