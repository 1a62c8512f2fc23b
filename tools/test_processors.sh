#!/usr/bin/env bash
# Run tests as on other processors: each library is told not to use some of this processor's instructions, or to use
# another number of threads. Prints a table of the failures at the end; exits with 1 if there are any.
#
#   tools/test_processors.sh [TEST FILES...]     default: the whole suite
#   SETTINGS="aten-default old-x86" tools/...    only these settings
#
# Switches: https://numpy.org/doc/stable/reference/simd/build-options.html (NPY_DISABLE_CPU_FEATURES),
# OpenBLAS's README (OPENBLAS_CORETYPE), OpenCV's documentation of environment variables (OPENCV_CPU_DISABLE),
# Numba's reference (NUMBA_CPU_NAME), PyTorch's ATEN_CPU_CAPABILITY, oneDNN's ONEDNN_MAX_CPU_ISA.
set -u
cd "$(dirname "$0")/.."
python="${VENV:-.venv}/bin/python"
export PYTHONPATH="$PWD${PYTHONPATH:+:$PYTHONPATH}"
logs="$(mktemp -d)"

numpy_baseline="NPY_DISABLE_CPU_FEATURES=$("$python" - <<'PY'
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

print(" ".join(name for name in __cpu_dispatch__ if __cpu_features__.get(name)))
PY
)"
opencv_baseline="OPENCV_CPU_DISABLE=AVX512-SKX,AVX2,FP16,AVX,SSE4.2,SSE4.1"

declare -A settings=(
  [as-it-is]="OMP_NUM_THREADS=1"
  [aten-default]="OMP_NUM_THREADS=1|ATEN_CPU_CAPABILITY=default"
  [aten-avx2]="OMP_NUM_THREADS=1|ATEN_CPU_CAPABILITY=avx2"
  [openblas-haswell]="OMP_NUM_THREADS=1|OPENBLAS_CORETYPE=Haswell"
  [openblas-nehalem]="OMP_NUM_THREADS=1|OPENBLAS_CORETYPE=Nehalem"
  [openblas-prescott]="OMP_NUM_THREADS=1|OPENBLAS_CORETYPE=Prescott"
  [opencv-baseline]="OMP_NUM_THREADS=1|$opencv_baseline"
  [numba-generic]="OMP_NUM_THREADS=1|NUMBA_CPU_NAME=generic"
  [numpy-baseline]="OMP_NUM_THREADS=1|$numpy_baseline"
  [two-threads]="OMP_NUM_THREADS=2"
  [old-x86]="OMP_NUM_THREADS=1|ATEN_CPU_CAPABILITY=default|ONEDNN_MAX_CPU_ISA=SSE41|OPENBLAS_CORETYPE=Nehalem|$opencv_baseline|NUMBA_CPU_NAME=generic|$numpy_baseline"
)
order="as-it-is aten-default aten-avx2 openblas-haswell openblas-nehalem openblas-prescott opencv-baseline
  numba-generic numpy-baseline two-threads old-x86"

failed=0
table="$(printf '%-20s %-10s %s' setting status failed)"
for name in ${SETTINGS:-$order}; do
  [ -n "${settings[$name]-}" ] || { echo "test_processors.sh: no setting '$name'; expected one of:" $order >&2; exit 2; }
  IFS='|' read -ra variables <<<"${settings[$name]}"
  echo "== $name: ${variables[*]}"
  env "${variables[@]}" "$python" -m pytest -q -n 2 --dist worksteal -p no:cacheprovider "$@" \
    >"$logs/$name" 2>&1
  status=$?
  tail -n 1 "$logs/$name"
  [ "$status" = 0 ] || failed=1
  names="$(sed -nE 's/^(FAILED|ERROR) ([^ ]+).*/\2/p' "$logs/$name" | sort -u | tr '\n' ' ')"
  table+=$'\n'"$(printf '%-20s %-10s %s' "$name" "$status" "${names:--}")"
done
printf '%s\n' "$table"
[ "$failed" = 0 ] || echo "logs: $logs"
exit "$failed"
