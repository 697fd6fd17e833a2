#!/bin/sh
# The program for Windows, in Wine. Its first job must reach the quality of this machine's program.
. "$(dirname "$0")/common.sh"
no_rust
packages wine wine64 unzip
tarball
scenes="$HOME/.local/share/lumistack/scenes"
installs unzip -q "$(one "lumistack-*-x86_64-pc-windows-*.zip")" -d windows
cat > lumistack <<WINE
#!/bin/sh
WINEDEBUG=-all exec wine "$(echo "$WORK"/windows/*/bin/lumistack.exe)" "\$@"
WINE
chmod +x lumistack
first_job ./lumistack "$scenes"
same_quality Wine "$scenes"
