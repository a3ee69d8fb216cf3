#!/usr/bin/env bash
# Installs what `make demo` and `make test` need: virtual environment, Python packages, and a Vulkan
# device that SAPIEN accepts (Mesa's software driver, only if there is no other).
# PYTHON names the interpreter; RENDER=no skips Vulkan.
set -euo pipefail
cd "$(dirname "$0")/.."

TORCH="torch==2.13.0"
MESA="24.3" # older software drivers: SAPIEN finds no device

say() { printf '== %s\n' "$*"; }
fail() {
    printf '\nset-up stopped: %s\n' "$1" >&2
    shift
    [ $# -eq 0 ] || printf '    %s\n' "$@" >&2
    exit 1
}

as_root() {
    if [ "$(id -u)" -eq 0 ]; then
        "$@"
    elif command -v sudo >/dev/null && { [ -t 0 ] || sudo -n true 2>/dev/null; }; then
        sudo "$@"
    else
        return 1
    fi
}

# apt_install WHY PACKAGE...
apt_install() {
    local why=$1
    shift
    command -v apt-get >/dev/null || fail "$why, and there is no apt-get here." \
        "Debian's names of what is needed: $*"
    say "$why: installing $*"
    as_root apt-get update -qq && as_root env DEBIAN_FRONTEND=noninteractive \
        apt-get install -y -qq --no-install-recommends "$@" >/dev/null ||
        fail "$why, and installing it did not work. As root:" \
            "apt-get update" "apt-get install --no-install-recommends $*" "then run make again."
}

right_version() {
    "$1" -c 'import sys; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 12)))' 2>/dev/null
}

# --- virtual environment -----------------------------------------------------------------------
if ! { right_version .venv/bin/python && .venv/bin/python -m pip --version >/dev/null 2>&1; }; then
    python=""
    for candidate in ${PYTHON:-python3.11 python3.12 python3}; do
        if right_version "$candidate"; then
            python=$candidate
            break
        fi
    done
    [ -n "$python" ] || fail "no Python 3.11 or 3.12 among: ${PYTHON:-python3.11 python3.12 python3}." \
        "Debian 12:          apt-get install python3 python3-venv" \
        "Ubuntu 24.04:       apt-get install python3.12 python3.12-venv" \
        "other distributions: install Python 3.11 (for instance with uv, pyenv or conda)," \
        "then say where it is: make setup PYTHON=/path/to/python3.11"
    if ! "$python" -c 'import ensurepip' 2>/dev/null; then
        version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
        apt_install "Python's venv module is missing" "python$version-venv"
    fi
    say "virtual environment .venv from $("$python" --version)"
    "$python" -m venv --clear .venv
fi
pip() { .venv/bin/python -m pip --disable-pip-version-check "$@"; }

# Installs packages and prints pip's output without its notes about locations that it ignored.
# Modules are compiled on import: pip would take a minute for seven million lines, most of which are never imported.
install() {
    local failed=""
    pip install -q --no-compile --progress-bar off "$@" >.venv/pip.log 2>&1 || failed=yes
    grep -vE "^WARNING: Location '.*' is ignored|^WARNING: Running pip as the 'root' user" .venv/pip.log >&2 || true
    [ -z "$failed" ] || fail "pip could not install $*" "all that it said is in .venv/pip.log"
}

# --- Python packages ---------------------------------------------------------------------------
if ! pip show -q torch 2>/dev/null; then
    say "$TORCH (a CPU build is taken where pip is pointed at one, the CUDA build elsewhere)"
    install "$TORCH"
fi
say "Python packages (about two minutes the first time)"
install -e ".[dev,docs,envs,export,foreign,stl,dask,ray,submitit]"
# mani-skill requires opencv-python, which writes to the same cv2 folder as the headless build and needs libGL.
# The last one installed wins, so the headless build, which can be imported everywhere, is installed again.
if pip show -q opencv-python 2>/dev/null || ! .venv/bin/python -c 'import cv2' 2>/dev/null; then
    headless=$(.venv/bin/python -c 'from importlib.metadata import version as v; print(v("opencv-python-headless"))')
    pip uninstall -q -y opencv-python 2>/dev/null
    install --force-reinstall --no-deps "opencv-python-headless==$headless"
fi
# Pinocchio's package does not include the OpenMP library that it links to.
if ! .venv/bin/python -c 'import pinocchio' 2>.venv/pinocchio.log; then
    grep -q libgomp .venv/pinocchio.log || fail "pinocchio cannot be imported: $(tail -n 1 .venv/pinocchio.log)"
    apt_install "the OpenMP library is missing" libgomp1
fi

# --- Vulkan ------------------------------------------------------------------------------------
found="" # result of the last test picture, in a sentence
draws() {
    found=$(.venv/bin/python -P rf_exp/sim/vulkan.py 2>.venv/vulkan.log) && return
    found=${found:-$(tail -n 1 .venv/vulkan.log)}
    return 1
}

add_backports() { # Debian 12's own Mesa is too old
    apt-get indextargets --format '$(RELEASE)' | grep -qx bookworm-backports && return
    local mirror
    mirror=$(apt-get indextargets --format '$(RELEASE) $(SITE)' | awk '$1 == "bookworm" {print $2; exit}') || mirror=""
    local line="deb ${mirror:?no source of bookworm among those of apt} bookworm-backports main"
    say "apt source of bookworm-backports"
    echo "$line" | as_root tee /etc/apt/sources.list.d/rf_exp-backports.list ||
        fail "Debian 12's Mesa is too old for SAPIEN, and its backports need root. As root:" \
            "echo '$line' > /etc/apt/sources.list.d/rf_exp-backports.list" "apt-get update" \
            "apt-get install --no-install-recommends -t bookworm-backports mesa-vulkan-drivers libvulkan1" \
            "then run make again; or go without pictures: make setup RENDER=no"
}

if [ "${RENDER:-yes}" = no ]; then
    say "Vulkan left out (RENDER=no): run with render=false"
elif draws; then
    say "Vulkan: $found"
else
    say "Vulkan: no picture yet: $found"
    command -v apt-get >/dev/null || fail "SAPIEN found no Vulkan device: $found" \
        "Install Mesa's software Vulkan driver (lavapipe), $MESA or later, and the Vulkan loader:" \
        "Fedora: dnf install mesa-vulkan-drivers vulkan-loader" \
        "Arch:   pacman -S vulkan-swrast vulkan-icd-loader" \
        "then run make again; or go without pictures: make setup RENDER=no"
    suite=()
    if (. /etc/os-release && [ "${VERSION_CODENAME:-}" = bookworm ]); then
        add_backports
        suite=(-t bookworm-backports)
    fi
    apt_install "no Vulkan device that SAPIEN accepts" "${suite[@]}" mesa-vulkan-drivers libvulkan1
    draws || fail "SAPIEN still finds no Vulkan device: $found" \
        "Mesa here: $(dpkg-query -W -f '${Version}' mesa-vulkan-drivers); $MESA or later is needed" \
        "(Debian 12 backports, Debian 13, Ubuntu 24.04 with its updates)." \
        "To look closer: .venv/bin/python -m rf_exp.doctor; to go without pictures: make setup RENDER=no"
    say "Vulkan: $found"
fi
say "ready"
