"""Vectors as numba types: code that looks like scalar code and always compiles to vector instructions.

A loop over lanes is vectorised only where the compiler can prove that it may and thinks that it pays. A
:class:`Vector` is one value of LLVM's vector types instead; LLVM splits it into the registers that the
processor has. Operands that are numbers are taken for every lane.

A table is the address of numbers (:func:`~cyclofeat.simulators._jit.addresses`); row r holds the numbers of
all lanes.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable
from typing import Any

import numba.core.cgutils
import numba.core.typing.templates
import numba.extending
from llvmlite import ir

from cyclofeat.simulators._jit import addresses as addresses

# Never "reassoc": the order of sums must not depend on how the compiler unrolls a loop over contacts.
FASTMATH = {"contract", "nsz"}
# numba states types for the names that its decorators give new meanings.
_extending: Any = numba.extending
_templates: Any = numba.core.typing.templates
types: Any = numba.types
_cgutils: Any = numba.core.cgutils
intrinsic = _extending.intrinsic
_Primitive: Any = _extending.models.PrimitiveModel
_FLAGS = tuple(sorted(FASTMATH))
_ELEMENTS = {types.float32: ir.FloatType(), types.float64: ir.DoubleType()}
_SUFFIXES = {types.float32: "f32", types.float64: "f64"}


class Vector(types.Type):
    """Type of a vector: one number for each lane."""

    def __init__(self, element: types.Float, lanes: int) -> None:
        self.element, self.lanes = element, lanes
        super().__init__(name=f"Vector({element}, {lanes})")


class Mask(types.Type):
    """Type of a vector of truth values."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        super().__init__(name=f"Mask({lanes})")


def lane_tuple(count: int) -> tuple[int, ...]:
    """Return the number of lanes as an argument of compiled functions: each has its own machine code."""
    return (0,) * count


def _vector_ir(typ: Vector) -> ir.VectorType:
    return ir.VectorType(_ELEMENTS[typ.element], typ.lanes)


@_extending.register_model(Vector)
class _VectorModel(_Primitive):
    def __init__(self, manager: Any, typ: Vector) -> None:
        super().__init__(manager, typ, _vector_ir(typ))


@_extending.register_model(Mask)
class _MaskModel(_Primitive):
    def __init__(self, manager: Any, typ: Mask) -> None:
        super().__init__(manager, typ, ir.VectorType(ir.IntType(1), typ.lanes))


def _spread_number(builder: Any, value: Any, typ: Vector) -> Any:
    """The vector with one number in every lane."""
    undefined = ir.Constant(_vector_ir(typ), ir.Undefined)
    index = ir.IntType(32)
    first = builder.insert_element(undefined, value, ir.Constant(index, 0))
    zeros = ir.Constant(ir.VectorType(index, typ.lanes), [0] * typ.lanes)
    return builder.shuffle_vector(first, undefined, zeros)


def _common_vector(args: Iterable[types.Type]) -> Vector | None:
    """The type of the vectors among operands; the others must be numbers."""
    vectors = {arg for arg in args if isinstance(arg, Vector)}
    numbers = all(isinstance(arg, (Vector, types.Number)) for arg in args)
    return vectors.pop() if len(vectors) == 1 and numbers else None


def _as_arguments(args: Iterable[types.Type], vector: Vector) -> tuple[types.Type, ...]:
    return tuple(arg if isinstance(arg, Vector) else vector.element for arg in args)


def _spread_all(builder: Any, args: Any, kinds: Any, vector: Vector) -> list[Any]:
    return [
        value if isinstance(kind, Vector) else _spread_number(builder, value, vector)
        for value, kind in zip(args, kinds, strict=True)
    ]


def _register_operator(
    operation: Any, emit: Callable[..., Any], n: int = 2, *, kind: type = Vector, compares: bool = False
) -> None:
    """Make one of Python's operators, on ``n`` operands, known for vectors or masks."""

    class Template(_templates.AbstractTemplate):
        key = operation

        def generic(self, args: Any, kws: Any) -> Any:
            if kws or len(args) != n:
                return None
            if kind is Mask:
                same = len(set(args)) == 1 and isinstance(args[0], Mask)
                return _templates.signature(args[0], *args) if same else None
            vector = _common_vector(args)
            if vector is None:
                return None
            result = Mask(vector.lanes) if compares else vector
            return _templates.signature(result, *_as_arguments(args, vector))

    _templates.infer_global(operation)(Template)

    def lower_operator(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vector = _common_vector(sig.args)
        return emit(builder, *(_spread_all(builder, args, sig.args, vector) if vector else args))

    numbers = [(Vector, types.Float), (types.Float, Vector)] if kind is Vector and n == 2 else []
    for kinds in [(kind,) * n, *numbers]:
        _extending.lower_builtin(operation, *kinds)(lower_operator)


for _operation, _name in ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"),
                          (operator.truediv, "fdiv")):  # fmt: skip
    _register_operator(
        _operation, lambda builder, x, y, name=_name: getattr(builder, name)(x, y, flags=_FLAGS)
    )
for _operation, _sign in ((operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">=")):
    _register_operator(
        _operation, lambda builder, x, y, sign=_sign: builder.fcmp_ordered(sign, x, y), compares=True
    )
_register_operator(operator.neg, lambda builder, x: builder.fneg(x, flags=_FLAGS), 1)
_register_operator(operator.and_, lambda builder, x, y: builder.and_(x, y), kind=Mask)
_register_operator(operator.or_, lambda builder, x, y: builder.or_(x, y), kind=Mask)
_register_operator(operator.invert, lambda builder, x: builder.not_(x), 1, kind=Mask)


def _typed(result: Any, kinds: Iterable[Any], emit: Callable[..., Any]) -> Any:
    """Return signature and code of an intrinsic whose code ``emit`` makes of a builder and the arguments."""
    return result(*kinds), lambda context, builder, sig, values: emit(builder, *values)


def _library_function(name: str) -> Any:
    """An intrinsic of one vector that LLVM has."""

    def type_and_code(context: Any, vector: Any) -> Any:
        kind, full = _vector_ir(vector), f"llvm.{name}.v{vector.lanes}{_SUFFIXES[vector.element]}"

        def emit(builder: Any, x: Any) -> Any:
            function = _cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind]), full)
            return builder.call(function, [x], fastmath=_FLAGS)

        return _typed(vector, [vector], emit)

    return intrinsic(type_and_code)


def _choice(sign: str) -> Any:
    """An intrinsic of two vectors or numbers: the first where it compares so with the second, else that."""

    def type_and_code(context: Any, a: Any, b: Any) -> Any:
        vector: Any = _common_vector((a, b))
        kinds = _as_arguments((a, b), vector)

        def emit(builder: Any, *values: Any) -> Any:
            x, y = _spread_all(builder, values, kinds, vector)
            return builder.select(builder.fcmp_ordered(sign, x, y), x, y)

        return _typed(vector, kinds, emit)

    return intrinsic(type_and_code)


# The smaller and the larger of two numbers, lane by lane; the second where one is not a number.
smaller, larger = map(_choice, "<>")
# The square root, the largest whole number that is not larger, and the absolute value.
root, whole_below, magnitude = map(_library_function, ("sqrt", "floor", "fabs"))


@intrinsic
def choose(context: Any, mask: Any, a: Any, b: Any) -> Any:
    """``a`` where the mask is true, else ``b``."""
    vector: Any = _common_vector((a, b))
    kinds = _as_arguments((a, b), vector)

    def emit(builder: Any, chosen: Any, *values: Any) -> Any:
        return builder.select(chosen, *_spread_all(builder, values, kinds, vector))

    return _typed(vector, (mask, *kinds), emit)


def _row_address(builder: Any, vector: Vector, table: Any, index: Any, by_row: bool = True) -> Any:
    """Address of a vector in a row of a table, or from the index of a number on."""
    if by_row:
        index = builder.mul(index, ir.Constant(index.type, vector.lanes))
    return builder.bitcast(builder.gep(table, [index], inbounds=True), _vector_ir(vector).as_pointer())


def _load_at(by_row: bool) -> Any:
    """An intrinsic that loads the vector in a row of a table, or from the index of a number on."""

    def type_and_code(context: Any, table: Any, index: Any, lanes: Any) -> Any:
        vector = Vector(table.dtype, lanes.count)

        def emit(builder: Any, table: Any, index: Any, _: Any) -> Any:
            loaded = builder.load(_row_address(builder, vector, table, index, by_row))
            loaded.align = vector.element.bitwidth // 8
            return loaded

        return _typed(vector, (table, types.uintp, lanes), emit)

    return intrinsic(type_and_code)


load, load_from = _load_at(True), _load_at(False)


@intrinsic
def store(context: Any, table: Any, row: Any, value: Any) -> Any:
    """Write a vector into a row of a table."""

    def emit(builder: Any, table: Any, row: Any, written: Any) -> Any:
        stored = builder.store(written, _row_address(builder, value, table, row))
        stored.align = value.element.bitwidth // 8
        return ir.Constant(_cgutils.voidptr_t, None)

    return _typed(types.void, (table, types.uintp, value), emit)


@intrinsic
def fill_lanes(context: Any, number: Any, table: Any, lanes: Any) -> Any:
    """The vector with one number in every lane, of the kind of a table."""
    vector = Vector(table.dtype, lanes.count)
    kinds = vector.element, table, lanes
    return _typed(vector, kinds, lambda builder, one, *_: _spread_number(builder, one, vector))


@intrinsic
def join_lanes(context: Any, first: Any, second: Any) -> Any:
    """The vector with the lanes of two vectors, one after the other."""
    n = 2 * first.lanes
    indices = ir.Constant(ir.VectorType(ir.IntType(32), n), list(range(n)))
    return _typed(
        Vector(first.element, n), (first, second), lambda builder, x, y: builder.shuffle_vector(x, y, indices)
    )


@intrinsic
def round_to(context: Any, value: Any, table: Any) -> Any:
    """A vector in the numbers of a table: rounded, widened or as it is."""
    vector = Vector(table.dtype, value.lanes)
    change = vector.element.bitwidth - value.element.bitwidth

    def emit(builder: Any, x: Any, _: Any) -> Any:
        return x if change == 0 else (builder.fpext if change > 0 else builder.fptrunc)(x, _vector_ir(vector))

    return _typed(vector, (value, table), emit)


@intrinsic
def bits_of(context: Any, mask: Any) -> Any:
    """A mask as a whole number: bit k is lane k."""

    def emit(builder: Any, x: Any) -> Any:
        number = builder.bitcast(x, ir.IntType(mask.lanes))
        return number if mask.lanes == 64 else builder.zext(number, ir.IntType(64))

    return _typed(types.uint64, [mask], emit)


@intrinsic
def first_bit(context: Any, bits: Any) -> Any:
    """Index of the lowest bit of a whole number that is not zero."""
    one = ir.Constant(ir.IntType(1), 1)
    return _typed(types.uint64, [types.uint64], lambda builder, x: builder.cttz(x, one))


@intrinsic
def largest_lane(context: Any, value: Any) -> Any:
    """Return the largest number of a vector without NaN."""

    def emit(builder: Any, x: Any) -> Any:
        kind = ir.FunctionType(_ELEMENTS[value.element], [_vector_ir(value)])
        name = f"llvm.vector.reduce.fmax.v{value.lanes}{_SUFFIXES[value.element]}"
        function = _cgutils.get_or_insert_function(builder.module, kind, name)
        return builder.call(function, [x], fastmath=("nnan", *_FLAGS))

    return _typed(value.element, [value], emit)


@intrinsic
def lane_count(context: Any, lanes: Any) -> Any:
    """The number of lanes."""
    return _typed(types.uintp, [lanes], lambda builder, _: ir.Constant(ir.IntType(64), lanes.count))
