#!/usr/bin/env bash
# Run the Rust tests in optimised builds of 1 to 256 codegen units: check_units.sh [UNITS...]
#
# The number of units decides which functions the compiler optimises together, and so whether a fault of its back end
# (docs/notes/llvm-register-coalescer.md) meets our code. Only this crate is built again; its dependencies are not.
set -euo pipefail

profile=profile.develop
[ $# -gt 0 ] || set -- 1 4 16 40 256
for units in "$@"; do
    echo "codegen units: $units"
    CARGO_INCREMENTAL=0 cargo test --profile develop --quiet --lib --config "$profile.codegen-units=$units"
done
