"""Store the goldens anew and print what moved: README.md beside this.

python tests/golden/refresh.py [GOLDEN ...] [--check]
"""

import sys

from goldens import main

sys.exit(main())
