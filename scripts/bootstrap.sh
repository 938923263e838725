#!/usr/bin/env bash
# Makes .venv ready, from nothing but Python, for one of these profiles:
#
#   scripts/bootstrap.sh demo    the package and what `spatula demo` needs; no torch
#   scripts/bootstrap.sh test    that, and what tests, checks and training need; torch's CPU build, and a browser
#   scripts/bootstrap.sh ray     .venv-ray instead, with lock-ray.txt: what the tests with Ray need
#
# Versions come from requirements/lock.txt. PYTHON=... chooses the interpreter. A finished profile leaves a stamp made
# of the lock, pyproject.toml, this script, the interpreter and this folder, and is not set up again while the stamp holds.
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

# Every interpreter worth a look, best first. PyBullet has wheels for CPython 3.10 and 3.11, and for no later one.
candidates() {
    local name file
    for name in python3.11 python3.10 python3 python; do
        type -aP "$name" || true
    done
    for file in "$PYENV"/versions/3.11*/bin/python3.11 "$PYENV"/versions/3.10*/bin/python3.10; do
        if [[ -x $file ]]; then echo "$file"; fi
    done
}

# Makes an empty virtual environment with the first interpreter that manages to.
make_environment() {
    local python why choices allowed="3.11 3.10"
    if [[ -n ${PYTHON:-} ]]; then
        choices=$(type -P "$PYTHON") || fail "PYTHON=$PYTHON names no program that can be run."
        allowed="3.10 3.11 3.12"
    else
        choices=$(candidates)
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
${TRIED:-  python3.11, python3.10, python3 and python on PATH, and $PYENV/versions: none is there
}Install Python 3.11, or name an interpreter: make demo PYTHON=/path/to/python3.11"
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

# What an installed environment follows from, as one number.
stamp() {
    "$VENV/bin/python" -I -c '
import hashlib, os, pathlib, sys
digest = hashlib.sha256(repr((sys.version, sys.base_prefix, os.getcwd())).encode())
for name in sys.argv[1:]:
    digest.update(pathlib.Path(name).read_bytes())
print(digest.hexdigest())' "$LOCK" pyproject.toml scripts/bootstrap.sh
}

# Whether .venv belongs to this folder, was never left half made, and is of the interpreter that is asked for.
environment_stands() {
    [[ -f $VENV/.origin && ! -e $UNFINISHED ]] || return 1
    [[ $(cat "$VENV/.origin") == "$(identity "$VENV/bin/python") $PWD" ]] || return 1
    [[ -z ${PYTHON:-} || $(identity "$PYTHON") == "$(identity "$VENV/bin/python")" ]]
}

compiles_pybullet() {
    [[ "$(uname -sm)" != "Linux x86_64" ]] || "$VENV/bin/python" -c 'import sys; sys.exit(sys.version_info < (3, 12))'
}

set_up() {
    local note="" tools=(pip hatchling)
    if ! environment_stands; then
        stage "virtual environment in $VENV" make_environment
    else
        stage "virtual environment in $VENV: kept" true
    fi
    : >"$UNFINISHED"
    rm -f "$VENV"/.stamp-*
    printf '%s %s\n' "$(identity "$VENV/bin/python")" "$PWD" >"$VENV/.origin"
    if compiles_pybullet; then
        note="; PyBullet has no wheel here and compiles: 5 to 15 minutes more"
        tools+=(setuptools wheel numpy) # numpy first, or PyBullet is built without its fast camera images
    fi
    stage "pip and hatchling, at the locked versions" install "${tools[@]}"
    if [[ $1 != demo ]]; then
        stage "torch for the CPU (200 MB, about half a minute)" install_torch
        stage "spatula_env with $CONTENT (300 MB, about a minute$note)" \
            install --no-build-isolation --editable ".[$EXTRAS]"
        [[ $1 == ray ]] || stage "Chromium for the tests of the page (where it has to be installed, half a minute)" install_browser
    else
        stage "spatula_env and what the demo needs (200 MB, about half a minute$note)" \
            install --no-build-isolation --editable ".[$EXTRAS]"
    fi
    [[ $1 == test ]] && stamp >"$VENV/.stamp-demo" # the larger profile holds the smaller one
    stamp >"$VENV/.stamp-$1"
    rm -f "$UNFINISHED"
}

case ${1:-} in
    demo) FOR="demo" STAGES=3 EXTRAS="demo" ;;
    test) FOR="tests and checks" CONTENT="tests, checks and training" STAGES=5 EXTRAS="data,demo,dev,teleop,train,video,web" ;;
    ray)
        FOR="tests with Ray" CONTENT="Ray and tests" STAGES=4 EXTRAS="dev,ray"
        LOCK=requirements/lock-ray.txt VENV=.venv-ray
        ;;
    *) fail "usage: scripts/bootstrap.sh demo|test|ray; got '${1:-}'." ;;
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
