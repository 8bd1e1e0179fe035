#!/usr/bin/env bash
# Make a virtual environment with posefuse and the named extras (or "" for the core) in it: install.sh VENV EXTRAS
set -euo pipefail
venv=$1 extras=$2
[ -x "$venv/bin/python" ] || "${PYTHON:-python3}" -m venv "$venv"
pip=("$venv/bin/python" -m pip --disable-pip-version-check)

# PyTorch (wanted by the simulator's body model only) comes for Linux with gigabytes of CUDA packages.
# Where pip would fetch those, uv knows the CPU builds.
if [[ ",$extras," == *,sim,* ]] && ! "${pip[@]}" show -q torch 2>/dev/null; then
  torch=$(grep '^torch==' constraints.txt)
  plan=$("${pip[@]}" install --quiet --dry-run --ignore-installed --report - "$torch")
  if grep -qE '"name": "(nvidia|triton)' <<<"$plan"; then
    "${pip[@]}" install --quiet uv
    "$venv/bin/uv" pip install --python "$venv/bin/python" --torch-backend=cpu "$torch"
  else
    "${pip[@]}" install --quiet "$torch"
  fi
fi
# posefuse itself, and those of packages/ that an extra names; the others without what they require, so that their tests say so
wanted=(--editable ".${extras:+[$extras]}") others=()
for package in packages/*; do
  if [[ ",$extras," == *",${package#packages/posefuse-},"* ]]; then wanted+=(--editable "$package"); else others+=(--editable "$package"); fi
done
"${pip[@]}" install --quiet --constraint constraints.txt "${wanted[@]}"
if [[ ",$extras," == *,dev,* && ${#others[@]} -gt 0 ]]; then "${pip[@]}" install --quiet --no-deps "${others[@]}"; fi
