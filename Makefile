# Two commands do everything on a fresh machine, each on its own: `make avatar` and `make test`. `make install` only installs.
PYTHON ?= python3.11
VENV ?= .venv
OUT ?= avatar
# Tests run in this many processes, each on one thread.
WORKERS ?= 2
PYTEST = OMP_NUM_THREADS=1 $(VENV)/bin/python -m pytest --numprocesses $(WORKERS) --dist loadfile
PIP = $(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

.PHONY: avatar install test fast-test lint clean

avatar: $(VENV)/.installed
	$(VENV)/bin/python tools/export_avatar.py --out $(OUT) --overwrite

install: $(VENV)/.installed

test: $(VENV)/.installed-dev
	$(VENV)/bin/ruff check .
	$(PYTEST)

fast-test: $(VENV)/.installed-dev
	$(PYTEST) -m "not slow"

lint: $(VENV)/.installed-dev
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .

# torch goes first, and alone: pinned exactly, it is taken as the CPU build where one is offered.
$(VENV)/.torch: constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 13))' || \
		{ echo "sira_assets needs Python 3.11 or 3.12: make PYTHON=/path/to/python3.11 $(MAKECMDGOALS)"; exit 1; }
	test -x $(VENV)/bin/python || $(PYTHON) -m venv $(VENV)
	$(PIP) torch==2.13.0
	touch $@

# Open3D and pymeshlab are the two that lean on system libraries; say so here rather than after a fit.
CHECK = $(VENV)/bin/python -W ignore -c 'import open3d, pymeshlab' || \
	{ echo "open3d and pymeshlab need libGL, libX11, libgomp and libudev (Debian: apt-get install libgl1 libx11-6 libgomp1 libudev1)"; exit 1; }

$(VENV)/.installed: $(VENV)/.torch pyproject.toml constraints.txt
	$(PIP) --editable .
	@$(CHECK)
	touch $@

$(VENV)/.installed-dev: $(VENV)/.torch pyproject.toml constraints.txt
	$(PIP) --editable ".[dev]"
	@$(CHECK)
	touch $@ $(VENV)/.installed

clean:
	rm -rf $(VENV) $(OUT)
