#!/usr/bin/env bash
# Make a virtual environment with posefuse and the named extras (or "" for the core) in it: install.sh VENV EXTRAS
set -euo pipefail
venv=$1 extras=$2
[ -x "$venv/bin/python" ] || "${PYTHON:-python3}" -m venv "$venv"
pip=("$venv/bin/python" -m pip --disable-pip-version-check)

# posefuse itself, and those of packages/ that an extra names; the others without what they require, so that their tests say so
wanted=(--editable ".${extras:+[$extras]}") others=()
for package in packages/*; do
  if [[ ",$extras," == *",${package#packages/posefuse-},"* ]]; then wanted+=(--editable "$package"); else others+=(--editable "$package"); fi
done
"${pip[@]}" install --quiet --constraint constraints.txt "${wanted[@]}"
if [[ ",$extras," == *,dev,* && ${#others[@]} -gt 0 ]]; then "${pip[@]}" install --quiet --no-deps "${others[@]}"; fi
