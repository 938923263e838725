#!/usr/bin/env bash
# Makes .venv ready, from nothing but Python, for one of these profiles:
#
#   scripts/bootstrap.sh demo        the package and what `spatula demo` needs; no torch
#   scripts/bootstrap.sh test        that, and what tests, checks and training need; torch's CPU build, a browser, a display
#   scripts/bootstrap.sh ray         .venv-ray instead, with lock-ray.txt: what the tests with Ray need
#   scripts/bootstrap.sh lerobot     .venv-lerobot, with lock-lerobot.txt and Python 3.12 or 3.13: those with LeRobot
#   scripts/bootstrap.sh libraries   .venv-libraries, with libraries.in: those with other libraries for learning
#   scripts/bootstrap.sh docs        .venv-docs, with lock-docs.txt: what builds the site, and the archives to upload
#   scripts/bootstrap.sh matrix      .venv-matrix: nox, which tests the package with one interpreter after the other
#
# Versions come from requirements/lock.txt. PYTHON=... chooses the interpreter. A finished profile leaves a stamp made
# of the lock, pyproject.toml, this script, the interpreter and this folder, and is not set up again while the stamp holds.
#
#   scripts/bootstrap.sh interpreters   the folders of CPython 3.10 to 3.14, one for each version that runs here
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

LOCK=requirements/lock.txt
VENV=.venv
PYENV=${PYENV_ROOT:-${HOME:-}/.pyenv}
TRIED=""
STAGE=0
OPEN="" # not empty while a stage's line waits for its end

# The caller's settings for other environments must not leak into this one.
unset PYTHONHOME __PYVENV_LAUNCHER__
export PIP_USER=0 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_INPUT=1

fail() {
    [[ -z $OPEN ]] || printf 'failed\n'
    printf 'error: %s\n' "$1" >&2
    exit 1
}

# ---------------------------------------------------------------------------------------------- the interpreter

# Version and home of an interpreter. It fails for one that only pretends to exist, such as a version manager's shim.
identity() {
    "$1" -I -c 'import sys; print("%d.%d.%d" % sys.version_info[:3], sys.base_prefix)' 2>/dev/null </dev/null
}

# Says why the interpreter $1 cannot be used; says nothing when it can. $2: the versions allowed.
objection() {
    local version
    if ! version=$("$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null </dev/null); then
        echo "does not run"
    elif [[ " $2 " != *" $version "* ]]; then
        echo "is Python $version"
    elif ! "$1" -I -c 'import ensurepip, venv' >/dev/null 2>&1 </dev/null; then
        echo "is Python $version without venv or ensurepip (a package of the system, such as python3-venv, brings them)"
    fi
}

# Every interpreter worth a look. $@: the versions, best first. Those of a version manager come before what is called
# `python3`, so that a good version is not passed over for whatever that is.
candidates() {
    local version file name
    for version in "$@"; do
        type -aP "python$version" || true
        for file in "$PYENV"/versions/"$version"*/bin/"python$version"; do
            if [[ -x $file ]]; then echo "$file"; fi
        done
    done
    for name in python3 python; do
        type -aP "$name" || true
    done
}

# The folder of one interpreter of each version that runs here.
interpreters() {
    local version python
    for version in 3.10 3.11 3.12 3.13 3.14; do
        while IFS= read -r python; do
            # A version manager's shim may choose another interpreter elsewhere: what it leads to here is what counts.
            if [[ -z $(objection "$python" "$version") ]]; then
                "$python" -I -c 'import os, sys; print(os.path.join(sys.base_prefix, "bin"))'
                break
            fi
        done < <(candidates "$version")
    done
}

# Makes an empty virtual environment with the first interpreter that manages to.
make_environment() {
    local python why choices allowed=$VERSIONS
    if [[ -n ${PYTHON:-} ]]; then
        choices=$(type -P "$PYTHON") || fail "PYTHON=$PYTHON names no program that can be run."
    else
        # shellcheck disable=SC2086 # the versions are words
        choices=$(candidates $VERSIONS)
    fi
    while IFS= read -r python; do
        [[ -n $python ]] || continue
        why=$(objection "$python" "$allowed")
        if [[ -z $why ]]; then
            rm -rf "$VENV"
            if "$python" -m venv "$VENV" >/dev/null 2>&1 </dev/null && "$VENV/bin/python" -m pip --version >/dev/null 2>&1; then
                : >"$UNFINISHED"
                return
            fi
            rm -rf "$VENV"
            why="cannot make a virtual environment"
        fi
        TRIED+="  $python $why"$'\n'
    done <<<"$choices"
    fail "no suitable Python was found: CPython ${allowed// / or } with its venv module is needed.
Tried:
${TRIED:-  PATH and $PYENV/versions: none is there
}Install Python ${allowed%% *}, or name an interpreter: make ${TARGET} PYTHON=/path/to/python${allowed%% *}"
}

# ---------------------------------------------------------------------------------------------------- the stages

# One line for a stage of the work: what it does, then how long it took. $1: the text, the rest: the command.
stage() {
    local text=$1 start=$SECONDS
    shift
    STAGE=$((STAGE + 1))
    printf '[%d/%d] %s ... ' "$STAGE" "$STAGES" "$text"
    OPEN=yes
    "$@"
    OPEN=""
    printf '%d s\n' "$((SECONDS - start))"
}

# What pip says goes to the log, and to the screen when an installation fails.
quiet_pip() {
    "$VENV/bin/python" -m pip install --quiet --progress-bar off "$@" >"$LOG" 2>&1 </dev/null
}

# Every version comes from the lock.
try_install() {
    quiet_pip --constraint "$LOCK" "$@"
}

install() {
    try_install "$@" && return
    fail "pip could not install $*
$(tail -n 30 "$LOG")"
}

# The CPU build of torch comes first, so that no other package can ask for the CUDA one.
install_torch() {
    local version
    version=$(sed -n 's/^torch==\([0-9.]*\).*/\1/p' "$LOCK")
    if [[ $(uname -s) == Linux ]]; then
        try_install "torch==$version+cpu" && return
        if quiet_pip --dry-run --no-deps "torch==$version+cpu"; then
            install "torch==$version+cpu" # it is there, and something else went wrong: once more, then the reason
            return
        fi
        cat <<EOF
not found
warning: pip's sources have no CPU build torch==$version+cpu for this Python; the default build brings CUDA with it,
         several gigabytes. To avoid it, stop now, point pip at a CPU build (PIP_EXTRA_INDEX_URL with the CPU index that
         PyTorch's installation page names, or PIP_FIND_LINKS with a folder that holds the wheel) and start again.
EOF
        printf '      the default build of torch, with CUDA ... '
    fi
    install "torch==$version"
}

# A browser for the tests of the page: the system's, Debian's where it may be installed, or Playwright's own.
install_browser() {
    browser_runs && return
    if [[ $(id -u) == 0 ]] && type -P apt-get >/dev/null; then
        apt-get update >"$LOG" 2>&1 </dev/null || true
        DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends chromium >>"$LOG" 2>&1 </dev/null || true
        browser_runs && return
    fi
    "$VENV/bin/python" -m playwright install --only-shell chromium >>"$LOG" 2>&1 </dev/null && return
    printf 'none\nwarning: without Chromium, the tests marked "browser" are skipped; install it, and start them again.\n      '
}

browser_runs() {
    local name
    for name in chromium chromium-browser google-chrome google-chrome-stable; do
        # A stand-in that only says where to get it does not count.
        "$name" --version >/dev/null 2>&1 </dev/null && return
    done
    return 1
}

# A display that nobody sees, and OpenGL without a graphics card, for the tests of the window.
install_display() {
    display_runs && return
    if [[ $(id -u) == 0 ]] && type -P apt-get >/dev/null; then
        apt-get update >"$LOG" 2>&1 </dev/null || true
        # shellcheck disable=SC2086 # the packages are words
        DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends $DISPLAY_PACKAGES >>"$LOG" 2>&1 </dev/null || true
        display_runs && return
    fi
    printf 'none\nwarning: without Xvfb and OpenGL (Debian: %s) the tests of the window are skipped.\n      ' "$DISPLAY_PACKAGES"
}

DISPLAY_PACKAGES="xvfb libgl1-mesa-dri libglx-mesa0 libgl1"

display_runs() {
    [[ $(uname -s) == Linux ]] || return 0 # elsewhere there is no Xvfb, and a window needs none
    type -P Xvfb >/dev/null && "$VENV/bin/python" -c 'import ctypes; ctypes.CDLL("libGL.so.1")' 2>/dev/null
}

# What an installed environment follows from, as one number.
stamp() {
    "$VENV/bin/python" -I -c '
import hashlib, os, pathlib, sys
digest = hashlib.sha256(repr((sys.version, sys.base_prefix, os.getcwd())).encode())
for name in sys.argv[1:]:
    digest.update(pathlib.Path(name).read_bytes())
print(digest.hexdigest())' "$LOCK" ${INPUT:+"$INPUT"} ${ALONE:+"$ALONE"} pyproject.toml scripts/bootstrap.sh
}

# Whether .venv belongs to this folder, was never left half made, and is of the interpreter that is asked for.
environment_stands() {
    [[ -f $VENV/.origin && ! -e $UNFINISHED ]] || return 1
    [[ $(cat "$VENV/.origin") == "$(identity "$VENV/bin/python") $PWD" ]] || return 1
    [[ -z ${PYTHON:-} || $(identity "$PYTHON") == "$(identity "$VENV/bin/python")" ]]
}

set_up() {
    if ! environment_stands; then
        stage "virtual environment in $VENV" make_environment
    else
        stage "virtual environment in $VENV: kept" true
    fi
    : >"$UNFINISHED"
    rm -f "$VENV"/.stamp-*
    printf '%s %s\n' "$(identity "$VENV/bin/python")" "$PWD" >"$VENV/.origin"
    stage "pip and hatchling, at the locked versions" install pip hatchling
    [[ -z $TORCH ]] || stage "torch for the CPU (200 MB, about half a minute)" install_torch
    if [[ $1 == matrix ]]; then
        stage "nox (5 MB)" install nox
    else
        stage "spatula_env with $CONTENT" install ${INPUT:+--requirement "$INPUT"} --no-build-isolation --editable ".${EXTRAS:+[$EXTRAS]}"
    fi
    [[ -z $ALONE ]] || stage "libraries without what they ask for" install --no-deps --requirement "$ALONE"
    if [[ $1 == test ]]; then
        stage "Chromium for the tests of the page (where it has to be installed, half a minute)" install_browser
        stage "Xvfb and OpenGL for the tests of the window (where they have to be installed, half a minute)" install_display
    fi
    [[ $1 == test ]] && stamp >"$VENV/.stamp-demo" # the larger profile holds the smaller one
    stamp >"$VENV/.stamp-$1"
    rm -f "$UNFINISHED"
}

VERSIONS="3.11 3.12 3.13 3.10" # the interpreters that are taken, best first: 3.11 has wheels of everything
TORCH=yes
INPUT="" # requirements beside those of pyproject.toml
ALONE="" # packages that are installed without what they ask for
TARGET=test-${1:-}
case ${1:-} in
    demo)
        FOR="demo" CONTENT="what the demo needs (200 MB, about half a minute)" STAGES=3 EXTRAS="demo" TORCH="" TARGET=demo
        ;;
    test)
        FOR="tests and checks" CONTENT="tests, checks and training (300 MB, about a minute)" STAGES=6 TARGET=test
        EXTRAS="anatomy,data,demo,dev,mujoco,teleop,train,video,web,zoo"
        ;;
    ray)
        FOR="tests with Ray" CONTENT="Ray and tests (300 MB, about a minute)" STAGES=4 EXTRAS="ray,test"
        LOCK=requirements/lock-ray.txt VENV=.venv-ray
        ;;
    lerobot)
        # LeRobot asks for a torch between bounds of its own, of which pip's sources have the build with CUDA alone.
        FOR="tests with LeRobot" CONTENT="LeRobot (with CUDA: 6 GB on the disk, some minutes)" STAGES=3 EXTRAS="lerobot,test" TORCH=""
        LOCK=requirements/lock-lerobot.txt VENV=.venv-lerobot VERSIONS="3.12 3.13"
        ;;
    libraries)
        FOR="tests with other libraries" CONTENT="other libraries for learning (1 GB, some minutes)" STAGES=5
        EXTRAS="test,train" LOCK=requirements/lock-libraries.txt VENV=.venv-libraries VERSIONS="3.11 3.12"
        INPUT=requirements/libraries.in ALONE=requirements/libraries-alone.txt
        ;;
    docs)
        FOR="documentation" CONTENT="Sphinx (150 MB, about half a minute)" STAGES=3 EXTRAS="" TORCH="" TARGET=docs
        LOCK=requirements/lock-docs.txt VENV=.venv-docs VERSIONS="3.11 3.12 3.13" INPUT=requirements/docs.in
        ;;
    matrix)
        FOR="tests with all interpreters" STAGES=3 EXTRAS="" TORCH="" VENV=.venv-matrix
        ;;
    interpreters)
        interpreters
        exit
        ;;
    *) fail "usage: scripts/bootstrap.sh demo|test|ray|lerobot|libraries|docs|matrix|interpreters; got '${1:-}'." ;;
esac
LOG=$VENV/bootstrap.log
UNFINISHED=$VENV/.unfinished # stands from the first change to the environment until the last

# Two set-ups of one folder wait for each other, where the system can lock a file.
if command -v flock >/dev/null; then
    exec 9<"$LOCK"
    flock --nonblock 9 || { echo "Waiting for another set-up of this folder to end." && flock 9; } || true
fi
if environment_stands && [[ -f $VENV/.stamp-$1 && $(cat "$VENV/.stamp-$1") == "$(stamp)" ]]; then
    exit 0
fi
printf 'Setting up %s for the %s: once, later starts skip this.\n' "$VENV" "$FOR"
trap 'printf "\ninterrupted: the set-up starts afresh next time.\n" >&2; exit 130' INT TERM
set_up "$1"
