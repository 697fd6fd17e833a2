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
