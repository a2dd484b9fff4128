# make serve   set up .venv, then start the service on http://127.0.0.1:8000 with its data in ./data
# make test    set up .venv, then check lint, format and types, and run every test
#              make COVERAGE=yes test measures the branches of code that they take, and holds them above a floor
# make versions [VERSIONS="3.12 3.13"]
#              check on further interpreters what needs no torch
# make sanitize [MUTATIONS=n] [SEED=n]
#              the native code under sanitizers: its own tests, golden files, n damaged files
# make bench [FULL=yes IMAGES=folder WEIGHTS=folder]
#              a small set of all measurements in at most ten minutes, or everything that docs/results shows
# make fuzz [MINUTES=n]
#              look for inputs that break the decoder, n minutes for each of three targets; needs Clang
# make cross   compile the kernels for other machines, and run what can be run here; takes what compilers there are
# make wheel   pack the source, build wheels of it for this system, and decode with each where it is installed alone; the
#              results lie in dist
# make npm     the package for browsers: built, held to its sizes, compared with the page's decoder, and packed in dist
# make wasm    the decoder in WebAssembly, in build/wasm, and its tests; needs Clang and Debian's libraries for it
#
# The set-up is done again only when pyproject.toml or a source of the compiled part changes. Edits to Python
# files take effect at once.

# The interpreter for .venv, 3.11 or later: make PYTHON=python3.12 test
PYTHON ?= python3
# Installed first, so that you choose the build: make TORCH=torch==2.6.0 serve
TORCH ?= torch==2.13.0

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
SERVED := $(VENV)/.service
OTHERS := $(VENV)/.benchmark
COMPILED := $(shell find sgmethod/native -name "*.cpp" -o -name "*.h" -o -name CMakeLists.txt)
# The quick tests of single modules first, those of whole processes after them.
TESTS := $(sort $(wildcard tests/test_*.py)) $(sort $(dir $(wildcard tests/*/test_*.py))) tests/service

# Plain Python takes twice as long when it is measured, and neither the second decoders nor the benchmarks are part of
# the packages.
UNMEASURED := $(wildcard tests/bitstream/test_format_*.py tests/bitstream/fuzz/test_fuzz_*.py) tests/benchmarks/
# About half of the service's tests, all of which mostly wait: for processes that start, end or are killed.
WHOLE := tests/service/whole tests/service/process tests/service/worker
# About half of the other tests, so that neither half has the machine for itself in the end.
ENCODES := tests/cli/ tests/rd/
# The service's encoders stand behind all who answer, so behind tests that compute as well, unless those do so too: without
# this an encode beside them has a hundredth of a core.
YIELDING := nice -n 19
# Threads that share a core wait for each other, which takes a third more of it: four parts at a time take one thread
# each, and one part all of them, as users do.
SINGLE := SG_THREADS=1
COVERAGE ?=
# Without ninja, CMake calls make, which by itself compiles one file at a time.
CORES := $(shell nproc)
export CMAKE_BUILD_PARALLEL_LEVEL ?= $(CORES)
# Further targets, made beside the measured tests.
ALSO ?=
VERSIONS ?= 3.12 3.13 3.14
# The fuzzer of Python code.
ATHERIS := atheris>=3
MUTATIONS ?= 10000
MINUTES ?= 5

.PHONY: serve check types test measured measured-encodes measured-service measured-whole unmeasured versions sanitize fuzz cross wheel npm wasm bench

serve: $(SERVED)
	$(BIN)/python -m service serve

check: $(STAMP)
	@command -v initdb >/dev/null || ls /usr/lib/postgresql/*/bin/initdb >/dev/null 2>&1 || \
	  echo "PostgreSQL is missing, so its tests will be skipped: sudo apt install postgresql" >&2
	@command -v chromedriver >/dev/null && command -v chromium >/dev/null || \
	  echo "Chromium is missing, so the page will not be tested: sudo apt install chromium chromium-driver" >&2
	@command -v firefox-esr >/dev/null || \
	  echo "Firefox is missing, so the page will not be tested in it: sudo apt install firefox-esr" >&2
	@command -v nginx >/dev/null || \
	  echo "nginx is missing, so nothing will be tested behind it: sudo apt install nginx-light" >&2
	$(BIN)/python -m ruff check .
	$(BIN)/python -m ruff format --check .

types: $(STAMP)
	$(YIELDING) $(BIN)/python -m mypy

# Measured, four parts at a time: those of the service mostly wait, and leave two cores to the others.
test: check
ifeq ($(COVERAGE),)
	$(BIN)/python -m mypy
	$(BIN)/python -m pytest $(TESTS)
else
	$(BIN)/python -m coverage erase
	$(MAKE) --jobs 4 measured-whole measured-service measured-encodes measured types $(ALSO) unmeasured
	$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage report
endif

measured: $(STAMP)
	$(YIELDING) $(BIN)/python -m coverage run -m pytest $(filter-out tests/service $(ENCODES) $(UNMEASURED),$(TESTS)) \
	  $(addprefix --ignore=,$(UNMEASURED))

measured-encodes: $(STAMP)
	$(SINGLE) $(YIELDING) $(BIN)/python -m coverage run -m pytest --quiet $(ENCODES)

measured-whole: $(STAMP)
	$(SINGLE) $(BIN)/python -m coverage run -m pytest --quiet $(WHOLE)

measured-service: $(STAMP)
	$(SINGLE) $(BIN)/python -m coverage run -m pytest --quiet $(filter tests/service,$(TESTS)) $(addprefix --ignore=,$(WHOLE))

unmeasured: $(STAMP)
	$(SINGLE) $(YIELDING) $(BIN)/python -m pytest --quiet $(UNMEASURED)

versions:
	$(YIELDING) .ci/versions $(VERSIONS)

sanitize: $(STAMP)
	$(YIELDING) $(BIN)/python -m tests.native.sanitize --mutations $(MUTATIONS) $(if $(SEED),--seed $(SEED))

fuzz: $(STAMP)
	$(BIN)/python -m pip show --quiet atheris || $(BIN)/python -m pip install '$(ATHERIS)'
	$(BIN)/python -m tests.native.fuzz --minutes $(MINUTES)

# Other systems' libraries come with zig, a C++ compiler; without it they are left out, and said to be.
cross: $(STAMP)
	$(BIN)/python -m tests.native.cross

wheel: $(STAMP)
	$(BIN)/python -m tests.wheels

npm:
	@command -v npm >/dev/null || { echo "The package for browsers needs npm: sudo apt install npm" >&2; exit 1; }
	mkdir -p build/npm dist
	cp -r service/npm/. LICENSE build/npm/
	cd build/npm && npm install --silent --no-audit --no-fund --no-package-lock && node build.mjs ../../service/web/static \
	  && npm pack --silent --pack-destination ../../dist

WASM_CLANG ?= clang++
WASM_SOURCES := $(wildcard $(addprefix sgmethod/native/,core/isa.cpp texture/*.cpp raster/*.cpp rd/codec.cpp rd/symbols.cpp \
                file/file.cpp file/view.cpp wasm/*.cpp))
WASM_FLAGS := --target=wasm32-wasi -mexec-model=reactor -msimd128 -std=c++17 -stdlib=libc++ -O2 -ffp-contract=off \
              -fno-math-errno -fno-trapping-math -fno-exceptions -fno-rtti -ffunction-sections -fdata-sections -DNDEBUG \
              -Wall -Wextra -Isgmethod/native -Wl,-z,stack-size=1048576 -s

wasm: $(STAMP) build/wasm/decoder.wasm
	$(BIN)/python -m pytest --quiet tests/native/decoder/test_wasm.py

build/wasm/decoder.wasm: $(COMPILED) sgmethod/native/wasm/decoder.js
	@ls /usr/include/wasm32-wasi/c++ >/dev/null 2>&1 && command -v $(WASM_CLANG) wasm-ld >/dev/null || { echo "WebAssembly" \
	  "needs packages: sudo apt install clang lld wasi-libc libc++-dev-wasm32 libclang-rt-dev-wasm32" >&2; exit 1; }
	mkdir -p build/wasm
	$(WASM_CLANG) $(WASM_FLAGS) $(WASM_SOURCES) -o $@
	cp sgmethod/native/wasm/decoder.js build/wasm/

bench: $(OTHERS)
	$(BIN)/python -m benchmarks $(if $(FULL),--full) $(if $(IMAGES),--images $(IMAGES)) $(if $(WEIGHTS),--weights $(WEIGHTS))

# The other codecs that are measured.
$(OTHERS): $(STAMP)
	$(BIN)/python -m pip install --editable '.[benchmark]'
	touch $@

# The stamp is written last: a set-up that was interrupted is taken up again by the next call. Python compiles a module
# when it is first imported: to compile all of PyTorch takes half a minute, and most of it is never used.
define SET_UP
@$(CHECK)
@echo "Setting up $(VENV) once, for some minutes: PyTorch first, then the kernels are compiled on $(CORES) cores"
$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
$(BIN)/python -m pip install --no-compile '$(TORCH)'
$(BIN)/python -m pip install --no-compile --editable '.[$(1)]'
endef

$(STAMP): pyproject.toml $(COMPILED)
	$(call SET_UP,test)
	touch $(SERVED) $@

# Without the tools that only the tests need.
$(SERVED): pyproject.toml $(COMPILED)
	$(call SET_UP,torch$(COMMA)service)
	touch $@

COMMA := ,
# Says in one sentence which Debian or Ubuntu packages are missing, before anything is downloaded or built.
PACKAGE := $(notdir $(PYTHON))
define CHECK
missing=; \
if ! command -v $(PYTHON) >/dev/null; then missing="$(PACKAGE) $(PACKAGE)-venv $(PACKAGE)-dev "; \
elif ! $(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then \
  echo "Python 3.11 or later is needed, and $(PYTHON) is older: sudo apt install python3.11 python3.11-venv" \
    "python3.11-dev, then: make PYTHON=python3.11 $(MAKECMDGOALS)" >&2; exit 1; \
else \
  $(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || missing="$(PACKAGE)-venv "; \
  $(PYTHON) -c 'import pathlib, sys, sysconfig; \
    sys.exit(not pathlib.Path(sysconfig.get_path("include"), "Python.h").exists())' \
    || missing="$${missing}$(PACKAGE)-dev "; \
fi; \
command -v $(CXX) >/dev/null || missing="$${missing}g++"; \
if [ -n "$$missing" ]; then echo "The set-up needs packages that are missing: sudo apt install $$missing" >&2; exit 1; fi
endef
