#!/usr/bin/env bash
# Install the system libraries that the tests or the benchmarks use, where that is possible: system_packages.sh test|bench
# Nothing here is needed to use fieldbake.
set -euo pipefail

# Library to look for, and the Debian package that has it.
case $1 in
    test) wanted=("libOSMesa.so.8 libosmesa6" "libvulkan.so.1 libvulkan1") ;;
    bench) wanted=("libusb-1.0.so.0 libusb-1.0-0" "libGL.so.1 libgl1" "libgomp.so.1 libgomp1") ;;
    *) echo "usage: $0 test|bench" >&2; exit 2 ;;
esac

missing=()
for entry in "${wanted[@]}"; do
    read -r library package <<<"$entry"
    ldconfig -p 2>/dev/null | grep -q "$library" || missing+=("$package")
done
if [ "$1" = test ] && ! ls /usr/share/vulkan/icd.d/*.json /etc/vulkan/icd.d/*.json >/dev/null 2>&1 \
    && [ -z "${VK_ICD_FILENAMES:-}${VK_DRIVER_FILES:-}" ]; then
    missing+=(mesa-vulkan-drivers) # lavapipe: Vulkan on the CPU
fi
if [ "$1" = test ] && ! command -v glslangValidator >/dev/null; then
    missing+=(glslang-tools) # compiles the GLSL texts
fi
if [ "$1" = test ] && ! command -v chromium >/dev/null && ! command -v chromium-browser >/dev/null \
    && ! command -v google-chrome >/dev/null; then
    missing+=(chromium) # draws live views and runs the GLSL texts
fi
if [ "$1" = test ] && ! command -v npm >/dev/null; then
    missing+=(nodejs npm) # bundles the viewer and drives the browser
fi
if [ "$1" = bench ] && [ ! -d /usr/include/eigen3 ]; then
    missing+=(libeigen3-dev) # pysdf is built from source
fi
if [ "$1" = bench ] && [ ! -d /usr/include/openvdb ]; then
    missing+=(libopenvdb-dev libboost-dev) # for benches/openvdb
fi
[ ${#missing[@]} -gt 0 ] || exit 0

if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "installing ${missing[*]}"
    if apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null; then
        exit 0
    fi
fi
echo "not installed: ${missing[*]}. What needs them is skipped; to have it: sudo apt install ${missing[*]}" >&2
