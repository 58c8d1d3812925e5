#!/bin/sh
# The live page in a browser: run.sh PROGRAM [FOLDER_OF_PICTURES]. Ends with 77 where that cannot be tried.
command -v node >/dev/null || { echo "skipped: there is no node (nodejs): the page is not tried in a browser"; exit 77; }
status=0
for test in page_test page_faults_test; do
  node "$(dirname "$0")/$test.mjs" "$@"
  ended=$?
  [ "$ended" -ne 77 ] || exit 77
  [ "$ended" -eq 0 ] || status=1
done
exit $status
