#!/bin/sh
# Installs the viewer's package with npm, and opens a page that uses it in a browser.
. "$(dirname "$0")/common.sh"
package=$(one "lumistack-viewer-*.tgz")
documented "$package"
packages nodejs npm chromium
tarball
small "$HOME/.local/bin/lumistack" "$HOME/.local/share/lumistack/scenes"
mkdir site
cd site
cp -r "$WORK/run/outputs/tensor-display/preview/stack" .
installs npm install --no-audit --no-fund "$package"
[ -s node_modules/lumistack-viewer/dist/types/viewer.d.ts ]
node "$HERE/page.mjs" .
