"""Measures functions of one module on request: lines [function, arguments, n] in, microseconds of one of n out."""

import importlib
import json
import sys
import time

module = importlib.import_module(sys.argv[1])
made = {}
for line in sys.stdin:
    function, arguments, n = json.loads(line)
    key = str((function, arguments))
    if key not in made:
        made[key] = getattr(module, function)(*arguments)
    start = time.perf_counter()
    made[key](n)
    print((time.perf_counter() - start) / n * 1e6, flush=True)
