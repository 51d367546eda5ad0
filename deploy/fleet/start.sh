#!/bin/sh
# The processes of docker-compose.yml in this folder without containers: two replicas and two estimators on the
# PostgreSQL server of SOO_DATABASE_URL, which is there already. Ports follow the first: replicas, then estimators, whose
# interface takes the orders of the spacecraft that they lead. SIGTERM or Ctrl-C ends all of them.
#
#   SOO_DATABASE_URL=postgresql+psycopg://soo@/soo SOO_BOOTSTRAP_KEY=... deploy/fleet/start.sh 8000
set -eu
port=${1:-8000}
children=
for role in --no-estimator --no-estimator --estimator --estimator; do
    # shellcheck disable=SC2086 # one option
    "${SOO:-soo}" serve "$role" --port "$port" &
    children="$children $!"
    port=$((port + 1))
done
# shellcheck disable=SC2086 # a list of processes
trap 'kill $children 2>/dev/null || true; wait; exit 0' TERM INT
wait
