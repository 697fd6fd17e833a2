#!/bin/sh
# Runs test programs for Windows in Wine: wine.sh LIST. Each line of the list has the name of a
# program, its folder, its path and its words, with tabs between them. Prints the time of each
# program. A program that hangs is killed after ten minutes.
set -eu
list=$1
tab=$(printf '\t')
# Wine's drive Z: is the root folder of this system. The repository is on this drive, and so are the
# temporary files, since tests name files without a drive. The name of the folder has a space and
# letters that are not ASCII, as names of users may have.
temporary='/tmp/Jürgen 日本'
rm -rf "$temporary"
mkdir -p "$temporary"
export WINEPREFIX="$HOME/wine" WINEDEBUG=-all,err+module WINEDLLOVERRIDES="mscoree=;mshtml=;winedbg.exe=d"
wine --version
wineboot --init
# shellcheck disable=SC1003
windows="Z:$(echo "$temporary" | tr / '\\')"
for name in TEMP TMP; do
    wine reg add 'HKCU\Environment' /v "$name" /d "$windows" /f >/dev/null
done
failed=
times=
while IFS=$tab read -r name folder file words; do
    echo "=== $name"
    cd "$folder"
    start=$(date +%s)
    # shellcheck disable=SC2086
    timeout --kill-after=5 600 wine "$file" $words </dev/null || failed="$failed $name"
    times="$times$(($(date +%s) - start)) $name
"
done <"$list"
wineboot --kill || true
printf '\nseconds  program\n%s' "$times" | awk '{ printf "%7s  %s\n", $1, $2 }'
[ -z "$failed" ] || { echo "failed in Wine:$failed" >&2; exit 1; }
