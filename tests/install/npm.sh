#!/bin/sh
# Installs the npm package with npm. A browser then shows the viewer in a page outside of the
# package.
. "$(dirname "$0")/common.sh"
packages nodejs npm chromium
tarball
small "$HOME/.local/bin/lumistack" "$HOME/.local/share/lumistack/scenes"
mkdir site
cd site
cp -r "$WORK/run/outputs/tensor-display/preview/stack" .
installs npm install --no-audit --no-fund "$(one "lumistack-viewer-*.tgz")"
[ -s node_modules/lumistack-viewer/dist/types/viewer.d.ts ]
node "$HERE/page.mjs" .
