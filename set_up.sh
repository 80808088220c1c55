#!/usr/bin/env bash
# Makes .venv beside this file, with the package and what the extras named need; goes on where an earlier call stopped.
#
#   ./set_up.sh [EXTRA ...]      extras of setup.py, such as campaign, export, video, test, check; make calls this
#   PYTHON=python3.12            the interpreter that .venv is made with
#
# On a sourced Jazzy .venv sees what apt has installed, and pip adds the rest. Otherwise ROS 2 comes from PyPI, and uv installs
# it, some five times as fast as pip: the uv on the PATH, or PyPI's. Where uv cannot be had pip does.

set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
PYTHON=${PYTHON:-python3}
BIN=.venv/bin
export PIP_RETRIES=${PIP_RETRIES:-2} # also of the pip that pip calls for what a build needs
FULL='No space left on device|os error 28|Disk quota exceeded|File too large|os error 27'
UNTRUSTED='CERTIFICATE_VERIFY_FAILED|invalid peer certificate|UnknownIssuer'
UNREACHABLE='dns error|error sending request|[Cc]onnection ?(refused|aborted|error|reset)|name resolution|new connection|Proxy ?Error|tunnel'
UNREACHABLE+='|Network is unreachable|timed out|ConnectTimeout|client error \(Connect\)'

fail() {
    printf 'error: %s\n' "$*" >&2
    exit 1
}

# Why an installer failed, in one sentence, from what it said.
explain() {
    local proxy=${HTTPS_PROXY:-${https_proxy:-${ALL_PROXY:-${all_proxy:-}}}}
    has() { grep -qE "$1" <<<"$said"; }
    if has "$FULL"; then
        fail "the disk is full, or a quota or limit (ulimit -f) is reached: '$PWD/.venv' takes 1.5 GB, the downloads half as" \
            "much in the cache of uv or pip (UV_CACHE_DIR, PIP_CACHE_DIR). Make room, then call make again: it goes on from here."
    elif has "$UNTRUSTED"; then
        fail "the package index shows a certificate that is not trusted here. Name the file with your organisation's in" \
            "SSL_CERT_FILE and PIP_CERT, then call make again."
    elif has "$UNREACHABLE"; then
        fail "the package index cannot be reached${proxy:+ through the proxy $(sed -E 's#//[^@/]*@#//#' <<<"$proxy")}. Check the" \
            "network${proxy:+, HTTPS_PROXY} and pip's index (pip config list), then call make again: it goes on from here."
    elif has '[Pp]ermission denied|os error 13'; then
        fail "a folder cannot be written: $(grep -m1 -oE '.{0,200}([Pp]ermission denied|os error 13)' <<<"$said")." \
            "It may belong to another user; change its owner or remove it, then call make again."
    elif has "command '[^']*(gcc|cc|clang)' failed|No such file or directory: '[^']*(gcc|cc|clang)'|compiler.* not found"; then
        fail "a package has no wheel for $($BIN/python -V) on $(uname -m) and cannot be compiled here. Install gcc, or take" \
            "another interpreter (make clean, then make PYTHON=python3.11 ...)."
    fi
    tail -n 5 <<<"$said" >&2
    fail "the packages cannot be installed, for the reason above. Call make again to go on from here."
}

make_venv() {
    [ ! -L .venv ] || fail "'$PWD/.venv' is a link to '$(readlink .venv)', and what is there is not touched. Remove the link."
    command -v "$PYTHON" >/dev/null ||
        fail "there is no '$PYTHON'. Install Python 3.10 to 3.13, or name it: make PYTHON=python3.12 ..."
    local version options=()
    version=$("$PYTHON" -c 'import sys; print("%d.%d" % sys.version_info[:2])') ||
        fail "'$PYTHON' does not start. Name another: make PYTHON=python3.12 ..."
    case "$version" in
    3.10 | 3.11 | 3.12 | 3.13) ;;
    *) fail "'$PYTHON' is Python $version; this package runs on 3.10 to 3.13. Name one: make PYTHON=python3.12 ..." ;;
    esac
    "$PYTHON" -c 'import venv, ensurepip' 2>/dev/null ||
        fail "Python $version has no venv module here. On Debian or Ubuntu: sudo apt install python$version-venv"
    [ "$kind" = wheels ] || options=(--system-site-packages)
    echo "making .venv with Python $version ($([ "$kind" = wheels ] && echo "ROS 2 from PyPI" || echo "on the sourced Jazzy"))"
    # What goes wrong in ensurepip venv itself does not tell.
    said=$({ "$PYTHON" -m venv --without-pip --clear "${options[@]}" .venv && $BIN/python -Im ensurepip; } 2>&1) || explain
    if [ "$kind" = jazzy ]; then # its compiled messages need the numpy they were built with
        "$PYTHON" -c 'import numpy; print("numpy==" + numpy.__version__)' >.venv/constraints.txt
    fi
    said=$({ printf '%s\n' "$key" >.venv/made-for; } 2>&1) || explain
}

# The index that pip's configuration names, for uv, which does not read it.
index_of_pip() {
    local name value
    while IFS='=' read -r name value; do
        value=$(sed "s/^'//; s/'\$//; s/\\\\n/ /g; s/^ *//" <<<"$value")
        case "${name##*.}" in
        index-url) export UV_DEFAULT_INDEX=${UV_DEFAULT_INDEX:-$value} ;;
        extra-index-url) export UV_INDEX=${UV_INDEX:-$value} UV_INDEX_STRATEGY=unsafe-best-match ;;
        find-links) export UV_FIND_LINKS=${UV_FIND_LINKS:-${value// /,}} ;;
        no-index) export UV_NO_INDEX=${UV_NO_INDEX:-$value} ;;
        cert) export SSL_CERT_FILE=${SSL_CERT_FILE:-$value} ;;
        proxy) export HTTPS_PROXY=${HTTPS_PROXY:-${https_proxy:-$value}} ;;
        esac
    done < <("${pip[@]}" config list 2>/dev/null)
}

# Install the package with extras, "[a,b]" or nothing.
install() {
    local pip=("$BIN/python" -m pip --disable-pip-version-check --no-input) constraint=() uv="" said="" again=()
    [ ! -e .venv/installing ] || again=(--reinstall) # it was interrupted, and what it was copying may be half there
    said=$(touch .venv/installing 2>&1) || explain
    if [ "$kind" = jazzy ]; then
        constraint=(--constraint .venv/constraints.txt)
    elif ! uv=$(command -v uv) && [ ! -x $BIN/uv ] && ! said=$("${pip[@]}" install uv 2>&1) && grep -qE "$FULL|$UNREACHABLE" <<<"$said"; then
        explain
    elif [ -z "$uv" ] && [ -x $BIN/uv ]; then
        uv=$BIN/uv
    fi
    if [ -n "$uv" ]; then
        echo "installing $what, by uv"
        index_of_pip
        said=$("$uv" pip install "${again[@]}" --python $BIN/python --editable ".$1" 2>&1) && rm .venv/installing && return
        ! grep -qE "$FULL" <<<"$said" || explain
        grep -qE "$UNREACHABLE" <<<"$said" ||
            echo "uv fails ($(grep -m1 -E 'error|×|╰' <<<"$said" | cut -c1-200 || echo "it says nothing")); so pip tries"
    else
        echo "installing $what, by pip: some minutes"
    fi
    "${pip[@]}" install "pip>=21.3" >/dev/null 2>&1 || true # an older one, as of Python 3.10.0, installs nothing in place
    said=$("${pip[@]}" install "${again[@]/--re/--force-re}" "${constraint[@]}" --editable ".$1" 2>&1) || explain
    rm .venv/installing
}

# Two kinds of environment: on top of a sourced Jazzy installation, or with ROS 2 from wheels.
kind=wheels
if [ -n "${ROS_DISTRO:-}" ]; then
    [ "$ROS_DISTRO" = jazzy ] || fail "ROS_DISTRO is '$ROS_DISTRO'; this package is for jazzy. Source Jazzy, or run in a shell" \
        "without ROS (ROS 2 then comes from PyPI)."
    if "$PYTHON" -c 'import rclpy' 2>/dev/null; then
        kind=jazzy
    elif [ -n "${AMENT_PREFIX_PATH:-}" ]; then
        fail "Jazzy is sourced, but '$PYTHON' cannot import its rclpy. Name the interpreter it was built for" \
            "(make PYTHON=/usr/bin/python3 ...), or run in a shell without ROS."
    fi
fi

# One set-up at a time; the lock ends with this process, however it ends.
exec 9<set_up.sh
if command -v flock >/dev/null && ! flock --nonblock 9; then
    echo "another make is setting up .venv; this one waits for it"
    flock 9
fi

# An environment of the other kind, of another folder (a copied checkout), or whose interpreter is gone is made anew.
key="$kind $PWD"
if [ "$(cat .venv/made-for 2>/dev/null)" != "$key" ] || ! [ -x $BIN/python ]; then
    make_venv
fi

missing=()
for extra in "" "$@"; do
    for file in setup.py setup.cfg package.xml pyproject.toml; do
        if [ ! ".venv/installed-$extra" -nt "$file" ]; then
            missing+=("$extra")
            break
        fi
    done
done
if [ ${#missing[@]} -gt 0 ]; then
    what="the extras $*"
    if [ -z "${missing[0]}" ]; then
        what="the package and what it needs, 0.5 GB$([ $# = 0 ] || echo ", and the extras $*")"
    fi
    wanted=()
    for extra in "$@"; do
        case "$kind $extra" in
        "jazzy oracle" | "jazzy interfaces") ;; # its numpy is not Jazzy's; apt has the generators
        *) wanted+=("$extra") ;;
        esac
    done
    [ "$kind" = jazzy ] || wanted+=(ros)
    install "${wanted[*]:+[$(IFS=, && echo "${wanted[*]}")]}"
    for extra in "${missing[@]}"; do
        touch ".venv/installed-$extra"
    done
fi

rooms=(dextar_control/{symbols,mechanisms,model,planning,estimation,control})
if [ ! .venv/warm -nt .venv/installed- ] || [ -n "$(find "${rooms[@]}" -name '*.py' -newer .venv/warm -print -quit)" ]; then
    $BIN/python -m dextar_control.control.prepare
    touch .venv/warm
fi
