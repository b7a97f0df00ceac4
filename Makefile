# Everything runs through tools/fenicsx, which finds or installs a DOLFINx (see its first lines).
#
# make test PYTEST_ARGS="-k mortar -x"    arguments for pytest
# make test QUICK=1                       without the runs on 2 and 3 ranks
# make test SAMPLE=                       all cases of each test, and all parallel tests on 2 and on 3 ranks
# make test WORKERS=4                     processes of the serial run (default: one a core)
# make test TIMEOUT=300                   seconds for a run on 2 or 3 ranks (default 1800)
# make docs DOCS_SIZES=full               demos as large as their prose says

FENICSX = tools/fenicsx
CACHE = $${XDG_CACHE_HOME:-$$HOME/.cache}/dolfinx_tresca
PYTEST_ARGS =
export DOCS_SIZES
# With it every process compiles all modules again: 2 s for this package, 6 s for the tests.
unexport PYTHONDONTWRITEBYTECODE
QUICK =
# What is left out (tests/conftest.py): make test-cores and make test-long run it.
SAMPLE = --sample=first
WORKERS = $(shell env -u OMP_NUM_THREADS nproc 2>/dev/null || getconf _NPROCESSORS_ONLN)

# Tests are dealt out to processes of one thread each; small matrices gain nothing by more.
SERIAL = $(FENICSX) python3 -m pytest -n $(WORKERS) --dist worksteal
PARALLEL = $(FENICSX) tools/mpi-pytest $(1) -m "parallel and not long" tests $(SAMPLE) $(PYTEST_ARGS)

# Whose pictures are in docs/: demos, and benchmarks.
DEMOS = two_bricks hertz implant floating_block adaptive fretting arch
DRAWN = convergence guaranteed peers published tradeoff

.PHONY: help demo docs look pictures test test-latest test-long test-cores test-paraview paraview-picture measure tables check \
	clean distclean
test test-long test-cores: export OMP_NUM_THREADS = 1

help:  ## print this list
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 18

demo:  ## two bricks with friction: solve, check, write results and a picture
	$(FENICSX) python3 demos/demo_two_bricks.py

test:  ## the tests: on one rank, and on 2 or 3 MPI ranks if they depend on the partition
	$(SERIAL) tests $(SAMPLE) $(PYTEST_ARGS)
ifeq ($(QUICK),)
	$(call PARALLEL,2)
	$(call PARALLEL,3)
endif

test-latest:  ## the tests with the latest DOLFINx, which comes from PyPI
	FENICSX_SUITE=wheels $(MAKE) --no-print-directory test

PARAVIEW_FILES = results/paraview

test-paraview:  ## files of all kinds, of 1, 2 and 3 ranks, as ParaView reads them
	rm -rf $(PARAVIEW_FILES)
	mkdir -p $(PARAVIEW_FILES)
	for ranks in 1 2 3; do \
		$(FENICSX) mpirun -n $$ranks python3 -m mpi4py tests/paraview/write.py $(PARAVIEW_FILES) || exit 1; \
	done
	tools/paraview pvpython --dr tests/paraview/compare.py $(PARAVIEW_FILES)

paraview-picture:  ## the picture in docs/paraview.md
	$(FENICSX) python3 demos/demo_two_bricks.py
	tools/paraview pvpython --dr docs/paraview_recipe.py results/two_bricks.pvd docs/paraview.png

test-cores:  ## all tests on one rank, with the arithmetic of the oldest processors and with this processor's
	@echo "test-cores: all tests on one rank, twice: first with the arithmetic of the oldest processors"
	$(FENICSX) tools/least-arithmetic python3 -m pytest -n $(WORKERS) --dist worksteal tests $(PYTEST_ARGS)
	@echo "test-cores: and with the arithmetic of this processor: $$(sed -n 's/^model name.*: //p' /proc/cpuinfo | head -n 1)"
	$(SERIAL) tests $(PYTEST_ARGS)

test-long:  ## what takes minutes: thousands of random scenes and the like, and all cases of all other tests
	$(SERIAL) -m long tests $(PYTEST_ARGS)
	$(FENICSX) tools/mpi-pytest 2 -m "long and parallel" tests $(PYTEST_ARGS)
	$(MAKE) --no-print-directory test SAMPLE=

pictures:  ## draw all pictures in docs/ again: demos, benchmarks (of what benchmarks/data keeps), ParaView's
	for demo in $(DEMOS); do $(FENICSX) python3 demos/demo_$$demo.py && cp results/$$demo.png docs/ || exit 1; done
	$(FENICSX) python3 benchmarks/convergence.py --json benchmarks/data/convergence.json
	for name in $(DRAWN); do \
		$(FENICSX) python3 benchmarks/$$name.py --from benchmarks/data/$$name.json \
			--picture docs/$$name.png || exit 1; \
	done
	$(FENICSX) python3 docs/contact_normals.py
	$(MAKE) --no-print-directory paraview-picture

measure:  ## measure all that benchmarks/README.md shows again: many hours, on a quiet machine; log in results
	python3 benchmarks/measure.py

tables:  ## write the tables of benchmarks/README.md again, of what benchmarks/data keeps
	$(FENICSX) python3 benchmarks/readme.py

# A second build runs only the demos that changed, or all of them if the package did.
docs:  ## the site, in results/docs/html: opens without a web server and without a network
	@echo "demos that changed run first: a minute or two if that is all of them"
	$(FENICSX) python3 -m sphinx -q -W --keep-going -d results/docs/doctrees docs results/docs/html
	@echo "results/docs/html/index.html"

look:  ## open all pages of the site in Debian's Chromium, in a root of its own: pictures, and what is wrong
	ROOT_PACKAGES=chromium-packages.txt ROOT_CHECK='chromium --version' \
		ROOT_HOLDS="Chromium, once: 260 MB to download, 0.9 GB on disk, 1 to 4 minutes" \
		tools/debian-root python3 docs/look.py results/docs/html results/docs/look

check:  ## style, format, types, the order of the layers and the shell scripts
	$(FENICSX) ruff check .
	$(FENICSX) ruff format --check .
	$(FENICSX) python3 -m mypy --strict dolfinx_tresca scenes
	$(FENICSX) lint-imports
	$(FENICSX) shellcheck $$(grep -lE -d skip '^#!/bin/(ba)?sh' tools/* .ci/*)

clean:  ## remove what runs leave in the checkout
	rm -rf results docs/tutorials/demo_*.md docs/tutorials/*.png docs/start/*.png .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +

# A root built by an ordinary user has files of other users in it: remove those as uid 0 of a namespace.
distclean: clean  ## remove the cached environments too (all clones share them)
	rm -rf --one-file-system "$(CACHE)" 2>/dev/null || \
		unshare --user --map-root-user --map-auto rm -rf --one-file-system "$(CACHE)"
