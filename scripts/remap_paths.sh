#!/usr/bin/env bash
# Print the RUSTFLAGS of a wheel: paths in the library do not depend on the machine that builds it.
set -euo pipefail
native() { if command -v cygpath >/dev/null; then cygpath -w "$1"; else printf '%s' "$1"; fi; }
root=$(cd "$(dirname "$0")/.." && pwd)
echo "--remap-path-prefix=$(native "${CARGO_HOME:-$HOME/.cargo}")=/cargo --remap-path-prefix=$(native "$root")=/fieldbake"
