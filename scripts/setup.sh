#!/usr/bin/env bash
# Makes .venv ready on a bare Debian or Ubuntu: Python's venv, the packages, OpenGL without a screen.
# Usage: scripts/setup.sh demo|dev|bench      (demo: what a run needs; dev: tests too; bench: peers to compare with too)
# PYTHON=... chooses the interpreter. Called by the Makefile, which looks at the stamps that this leaves.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

case "${1:-}" in
    demo) package="." covered=(demo) ;;
    dev) package=".[dev]" covered=(demo dev) ;;
    bench) package=".[dev,bench]" covered=(demo dev bench) ;;
    *) echo "usage: scripts/setup.sh demo|dev|bench" >&2; exit 2 ;;
esac

say() { printf 'setup: %s\n' "$*" >&2; }

as_root=()
if [ "$(id -u)" -ne 0 ]; then as_root=(sudo -n); fi
may_install() { command -v apt-get >/dev/null && { [ "$(id -u)" -eq 0 ] || sudo -n true 2>/dev/null; }; }

lists_are_fresh=no
apt_install() { # Debian packages; false where we may not, or where it failed
    may_install || return 1
    say "apt-get install $*"
    local attempt options=(-qq -y -o Acquire::Retries=3 -o DPkg::Lock::Timeout=300)
    for attempt in 1 2 3; do
        if [ "$lists_are_fresh" = yes ] || "${as_root[@]}" apt-get update "${options[@]}" >&2; then
            lists_are_fresh=yes
            "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
                apt-get install "${options[@]}" --no-install-recommends "$@" </dev/null >/dev/null && return 0
        fi
        sleep $((attempt * 3))
    done
    return 1
}

to_type() { # what a person has to type where we may not
    if command -v apt-get >/dev/null; then
        echo "sudo apt-get update && sudo apt-get install -y --no-install-recommends $*"
    else
        echo "(with your system's package manager) install what Debian calls: $*"
    fi
}

# -- Python 3.11 or 3.12 with venv ---------------------------------------------------------------------------------------
# Not later ones: dm-control needs labmaze, which has no wheels for them.
suits() { "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))' >/dev/null 2>&1; }
has_venv() { "$1" -c 'import ensurepip, venv' >/dev/null 2>&1; }

find_python() {
    local name
    if [ -n "${PYTHON:-}" ]; then
        if suits "$PYTHON"; then echo "$PYTHON"; return 0; fi
        say "PYTHON=$PYTHON is not Python 3.11 or 3.12"
        return 2
    fi
    for name in python3 python3.12 python3.11; do
        if suits "$name"; then echo "$name"; return 0; fi
    done
    return 1
}

if ! .venv/bin/python -c 'import pip' >/dev/null 2>&1 || ! suits .venv/bin/python; then
    python=$(find_python) || {
        [ $? -eq 1 ] || exit 1
        # Debian 12 and Ubuntu 24.04 have it as python3, Ubuntu 22.04 as python3.11.
        { apt_install python3 python3-venv && python=$(find_python); } \
            || { apt_install python3.11 python3.11-venv && python=$(find_python); } \
            || { say "Python 3.11 or 3.12 is needed; type:"; to_type python3 python3-venv >&2; exit 1; }
    }
    if ! has_venv "$python"; then
        venv_package=$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
        apt_install "$venv_package" && has_venv "$python" \
            || { say "$python cannot make virtual environments; type:"; to_type "$venv_package" >&2; exit 1; }
    fi
    say "making .venv with $("$python" --version)"
    "$python" -m venv --clear .venv
fi

# -- packages ------------------------------------------------------------------------------------------------------------
say "installing robocar and what it needs into .venv (some minutes the first time)"
.venv/bin/python -m pip install --quiet --disable-pip-version-check --retries 10 --timeout 60 \
    --constraint constraints.txt --editable "$package" </dev/null

# -- OpenGL without a screen: what draws a picture is there, whoever's driver it is ----------------------------------------
renders() { # says its last words where it cannot
    MUJOCO_GL="${MUJOCO_GL:-egl}" .venv/bin/python - 2>&1 <<'PYTHON' | tail -n 1
import mujoco

model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
renderer = mujoco.Renderer(model, 8, 8)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
renderer.update_scene(data)
raise SystemExit(0 if renderer.render().any() else "all pixels are black")
PYTHON
}

egl_packages=(libegl1 libgl1-mesa-dri libopengl0)
if ! why=$(renders); then
    { apt_install "${egl_packages[@]}" && why=$(renders); } || {
        say "MuJoCo cannot render without a screen: $why"
        say "libEGL or Mesa seems to be missing; type:"
        to_type "${egl_packages[@]}" >&2
        exit 1
    }
fi

# -- for the test that opens recordings in the real viewer; without these it is skipped ------------------------------------
viewer_packages=(mesa-vulkan-drivers libvulkan1 libxkbcommon0 libxkbcommon-x11-0)
viewer_can_start() {
    local libraries icd
    libraries=$(PATH="$PATH:/sbin:/usr/sbin" ldconfig -p)
    icd=$(ls /usr/share/vulkan/icd.d/*.json /etc/vulkan/icd.d/*.json 2>/dev/null || true)
    [ -n "$icd" ] && [[ $libraries == *libvulkan.so.1* && $libraries == *libxkbcommon.so.0* && $libraries == *libxkbcommon-x11.so.0* ]]
}
if [ "$1" != demo ] && ! viewer_can_start && ! apt_install "${viewer_packages[@]}"; then
    say "the test of the viewer will be skipped; to have it, type:"
    to_type "${viewer_packages[@]}" >&2
fi

# -- for the test that opens reports in a browser; without one it is skipped ------------------------------------------------
has_browser() { command -v chromium || command -v chromium-browser || command -v google-chrome; }
if [ "$1" != demo ] && ! has_browser >/dev/null && ! apt_install chromium; then
    say "the test of reports in a browser will be skipped; to have it, type:"
    to_type chromium >&2
fi

for name in "${covered[@]}"; do touch ".venv/.ready-$name"; done
say "ready"
