#!/bin/sh
# Checks the app, then tries the net without whatever it asks: every action succeeds after its stated time.
set -e
cd "$(dirname "$0")"
ctos=${CTOS:-ctos}
"$ctos" check app.toml
for count in 0 1 5; do
  "$ctos" net run work.net --tape "fetch $count" --stand-in --quiet
done
echo "all is well"
