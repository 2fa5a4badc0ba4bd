#!/usr/bin/env bash
# Make the project's Python environment: make_venv.sh PYTHON FOLDER
set -euo pipefail
python=$1 folder=$2

"$python" -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null || {
    echo "$python is missing or older than Python 3.10; install one and say: make PYTHON=python3.12 ..." >&2
    exit 1
}
"$python" -c 'import ensurepip, venv' 2>/dev/null || {
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        apt-get update -qq && apt-get install -y -qq --no-install-recommends "python$version-venv" >/dev/null
    else
        echo "$python cannot make environments; install its venv module (Debian: apt install python$version-venv)" >&2
        exit 1
    fi
}
[ -x "$folder/bin/python" ] || "$python" -m venv "$folder"
# Older pip does not know dependency groups.
"$folder/bin/pip" install --quiet --disable-pip-version-check 'pip>=25.1'
"$folder/bin/pip" install --quiet --group build
