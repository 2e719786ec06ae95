#!/bin/sh
# Install Debian/Ubuntu packages where that is allowed; otherwise print the one line that does, and fail.
# usage: scripts/apt_install.sh PACKAGE...
set -eu
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    export DEBIAN_FRONTEND=noninteractive
    echo "installing $*"
    apt-get update -qq </dev/null
    apt-get install -y -qq --no-install-recommends "$@" </dev/null >/dev/null
else
    echo "luxloop needs system packages that are missing here; install them with:" >&2
    echo "    sudo apt-get update && sudo apt-get install -y $*" >&2
    exit 1
fi
