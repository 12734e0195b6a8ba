# Everything here works from a clean clone: each target makes what it needs first, and a second call is quick.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.NOTPARALLEL:
MAKEFLAGS += --no-print-directory

# Arguments for `make run` and for pytest.
ARGS ?=
PYTEST_ARGS ?=

# Without a sourced ROS 2, nothing of another ROS or another workspace may leak into this one.
ISOLATE := $(if $(ROS_DISTRO),,unset PYTHONPATH LD_LIBRARY_PATH AMENT_PREFIX_PATH COLCON_PREFIX_PATH \
    CMAKE_PREFIX_PATH RMW_IMPLEMENTATION _ROS_WHEELS_BOOTSTRAP_COMPLETE;)

# $(call enter,ENVIRONMENT): its python is `python`.
enter = $(ISOLATE) export PATH="$(CURDIR)/$(1)/bin:$$PATH" PYTHONNOUSERSITE=1

# $(call source,ENVIRONMENT,PREFIX): also with the workspace built under PREFIX.
source = $(call enter,$(1)); set +u; . $(2)install/setup.bash; set -u

# $(call colcon_build,ENVIRONMENT,PREFIX): builds src/ into PREFIX{build,install,log} unless nothing changed.
# Its own packages are built anew, as colcon leaves modules behind whose source is gone.
define colcon_build
$(call enter,$(1)); \
now=$$( { find src config -type f -not -path '*/__pycache__/*' -not -path '*.egg-info/*' -not -path 'src/*/build/*' -print0 \
    | sort -z | xargs -0 sha256sum; find src -type l; cat $(1)/pyvenv.cfg $(1)/.done-[rj]*; } | sha256sum ); \
if [ "$$now" = "$$(cat $(2)install/.built 2>/dev/null)" ]; then \
    echo '==> build: $(2)install is up to date'; \
else \
    echo '==> build: colcon builds ftcm_core and ftcm_ros into $(2)install (some seconds)'; \
    rm -rf $(2)install/.built $(2){build,install}/ftcm_{core,ros}; \
    env -u PYTHONDONTWRITEBYTECODE PYTHONWARNINGS=ignore python -c 'from colcon_core.command import main; raise SystemExit(main())' \
        --log-base $(2)log build --base-paths src --build-base $(2)build --install-base $(2)install \
        --event-handlers desktop_notification-; \
    echo "$$now" > $(2)install/.built; \
fi
endef

# $(call pytest,MARKS): without PYTEST_ARGS side by side, one worker for each processor, then those that need the
# machine alone.
pytest = $(if $(PYTEST_ARGS),python -m pytest -m '$(1)' $(PYTEST_ARGS),\
    python -m pytest -n "$$(nproc)" --dist worksteal -m '$(1) and not alone' && python -m pytest -m '$(1) and alone')

.PHONY: help
help: ## Show this list
	@echo 'make TARGET, where TARGET is one of'
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)
	@echo 'FTCM_PYTHON=/path/to/python names the Python to use (CPython 3.10 to 3.13; 3.12 if there is one).'

.PHONY: env
env: ## Make .venv: ROS 2 Jazzy (unless one is sourced), colcon, Python packages
	@bash .ci/env run

.PHONY: build
build: env ## Build both packages with colcon into build/ and install/
	@$(call colcon_build,.venv,)

.PHONY: run
run: build ## Run the experiment of the paper: three controllers, a report; ARGS='...' for another
	@echo '==> run: ros2 run ftcm_ros experiment $(ARGS)'
	@$(call source,.venv,); exec install/ftcm_ros/lib/ftcm_ros/experiment $(ARGS)

.PHONY: test
test: lint test-here test-jazzy ## Lint, then all tests, then the quick ones of what depends on packages with Ubuntu 24.04's

.PHONY: test-env
test-env:
	@bash .ci/env test

.PHONY: test-here
test-here: test-env build ## Run all tests in .venv; PYTEST_ARGS='...' for some of them
	@echo '==> test: all tests'
	@$(call source,.venv,); $(call pytest,not docker and not nightly)

.PHONY: test-nightly
test-nightly: test-env build ## Run what `make test` leaves out: numbers and commands of the pages, more rounds of node faults
	@$(call source,.venv,); python -m pytest -n "$$(nproc)" --dist worksteal -m nightly $(PYTEST_ARGS)

.PHONY: docker-test
docker-test: test-env ## Build the image and run the integration tests in containers (skipped without a Docker engine)
	@if docker info >/dev/null 2>&1; then docker/build; fi
	@echo '==> docker-test: the suite in containers'
	@$(call enter,.venv); python -m pytest -m docker test/docker $(PYTEST_ARGS)

.PHONY: test-jazzy
test-jazzy: ## Run quick tests with numpy 1.26, setuptools 68 and others, as on Ubuntu 24.04
ifdef ROS_DISTRO
	@echo '==> test-jazzy: the sourced ROS 2 was tested already; nothing more to do'
else
	@bash .ci/env jazzy || { [ $$? -eq 3 ] || exit 1; echo '==> test-jazzy: SKIPPED, numpy 1.26 needs Python 3.10 to 3.12'; exit 0; }; \
	[ -e .venv-jazzy/.done-jazzy ] || exit 0; \
	$(call colcon_build,.venv-jazzy,.venv-jazzy/); \
	echo '==> test-jazzy: quick tests of what depends on packages, with the versions of Ubuntu 24.04'; \
	$(call source,.venv-jazzy,.venv-jazzy/); \
	$(call pytest,not slow and not docker and not nightly and (versions or not (ros or pure)))
endif

.PHONY: lint
lint: test-env ## Check style, format and types
	@echo '==> lint: ruff check, ruff format --check, mypy'
	@$(call enter,.venv); python -m ruff check --output-format concise . && \
	    python -m ruff format --check --output-format concise . && python -m mypy

.PHONY: site
site: ## Make a site of docs/ in build/site; it is read from there without a server
	@bash .ci/env site
	@$(call enter,.venv); python -m mkdocs build && echo "==> site: $(CURDIR)/build/site/index.html"

.PHONY: docs
docs: build ## Write what is generated: reference pages and pictures in docs/, the SROS2 policy, layouts
	@$(call source,.venv,); python tools/reference_page.py docs/ && python tools/topics_page.py docs/ && \
	    python tools/faults_page.py docs/ && \
	    python tools/sros_policy.py config/security/ && python tools/layouts.py config/layouts/

.PHONY: bench
bench: test-env build ## Measure rates, latencies, real time and the core into docs/measured.md; minutes, on an idle machine
	@$(call source,.venv,); python tools/bench_graph.py --core --output docs/measured.md $(ARGS)

.PHONY: soak
soak: build ## Run an hour in real time: no tick lost, no process growing; ARGS='--minutes 5' for less
	@$(call source,.venv,); python tools/soak.py $(ARGS)

.PHONY: clean
clean: ## Remove environments, build results and caches; runs/ stays
	rm -rf .venv .venv-jazzy build install log .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find src test tools -name __pycache__ -prune -exec rm -rf {} +
	rm -rf src/*/*.egg-info src/*/build
