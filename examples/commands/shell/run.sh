#!/bin/sh
# A damped oscillation: run.sh FREQUENCY DAMPING STOP STEP FILE.csv
awk -v frequency="$1" -v damping="$2" -v stop="$3" -v step="$4" 'BEGIN {
  print "time,x [m]"
  for (row = 0; row * step <= stop * (1 + 1e-9); row++) {
    time = row * step
    printf "%.12g,%.12g\n", time, exp(-damping * time) * cos(6.283185307179586 * frequency * time)
  }
}' > "$5"
