#!/bin/sh
# Checks the chart and its world, plays its test cases, runs the one in the other, and fails when the run does. ARMARIUM names the program.
set -eu
cd "$(dirname "$0")"
armarium=${ARMARIUM:-armarium}
"$armarium" check chart.yaml chart.test.yaml chart.world.yaml
"$armarium" test --complete chart.test.yaml
"$armarium" run chart.yaml --report report
echo "passed; report/report.html says how it went"
