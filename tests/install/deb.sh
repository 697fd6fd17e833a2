#!/bin/sh
# On a clean Debian, installs, uses and removes the Debian package. On other machines this script
# only unpacks and uses the package.
. "$(dirname "$0")/common.sh"
no_rust
deb=$(one "lumistack_*_$(dpkg --print-architecture).deb")
documented "$deb"
if [ -n "${CLEAN:-}" ]; then
    apt-get update -qq
    export DEBIAN_FRONTEND=noninteractive
    installs apt-get install -q -y "$deb"
    first_job lumistack /usr/share/lumistack/scenes
    apt-get remove -q -y lumistack
    [ ! -e /usr/bin/lumistack ]
else
    installs dpkg-deb -x "$deb" "$HOME/root"
    first_job "$HOME/root/usr/bin/lumistack" "$HOME/root/usr/share/lumistack/scenes"
fi
