#!/bin/sh
# The live page in a browser: run.sh PROGRAM [FOLDER_OF_PICTURES]. Ends with 77 where that cannot be tried. What the page does when
# things go wrong, which takes minutes of a quiet machine, is a part of script/soak: page_faults_test.mjs.
command -v node >/dev/null || { echo "skipped: there is no node (nodejs): the page is not tried in a browser"; exit 77; }
exec node "$(dirname "$0")/page_test.mjs" "$@"
