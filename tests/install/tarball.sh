#!/bin/sh
# Installs the tarball into ~/.local.
. "$(dirname "$0")/common.sh"
no_rust
tarball
PATH="$HOME/.local/bin:$PATH"
first_job lumistack "$HOME/.local/share/lumistack/scenes"
lumistack new made.toml --scene "$HOME/.local/share/lumistack/scenes/still-life/still-life.gltf" --no-questions
lumistack run made.toml --plan
for page in lumistack lumistack-run; do [ -s "$HOME/.local/share/man/man1/$page.1" ]; done
grep -q _lumistack "$HOME/.local/share/bash-completion/completions/lumistack"

# The windows of `show`, on a virtual screen: the list of outputs, then a preview of the run, which
# ends by the signal of Ctrl-C. A machine that is used for other purposes may lack a virtual screen.
packages xvfb libx11-6 libx11-xcb1 libxcursor1 libxi6 libxrandr2 libxkbcommon-x11-0 libvulkan1 mesa-vulkan-drivers
command -v Xvfb >/dev/null || { echo "without Xvfb, \`lumistack show\` is not tested"; exit; }
Xvfb :94 -screen 0 800x600x24 >xvfb.log 2>&1 &
screen=$!
trap 'kill $screen; rm -rf "$WORK"' EXIT
export DISPLAY=:94
for _ in $(seq 100); do lumistack show --list >outputs.txt 2>&1 && break; sleep 0.1; done
cat outputs.txt
grep -q "800 × 600 pixels" outputs.txt
lumistack show "$WORK/run" --preview --json --log frames.csv >show.log 2>&1 &
show=$!
for _ in $(seq 300); do ! grep -q '"started"' show.log || break; sleep 0.1; done
sleep 2
code=0
kill -INT $show
wait $show || code=$?
cat show.log
[ $code -eq 0 ] || { echo "the preview ended with code $code" >&2; exit 1; }
[ "$(wc -l <frames.csv)" -gt 10 ] || { echo "the preview showed too few frames" >&2; exit 1; }
