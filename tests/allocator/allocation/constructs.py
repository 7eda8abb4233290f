"""Functions for the printer: what it can print, and what it refuses for NumPy, for C or for both."""


def cases(text):
    """The functions behind each `### name`."""
    return dict(part.split("\n", 1) for part in text.split("### ")[1:])


CONSTRUCTS = cases("""
### sums
def f(x, y):
    return x + y - (x - (y - 2.5)) + -x - -(-y)
### products
def f(x, y):
    return 3 * x * (y * x) / (x / (y + 4)) / 2
### a division of whole numbers
def f(x, y):
    return (1 if x > 0 else 2) / 4 + 1 / 3 * y
### conditional expressions
def f(x, y):
    return (x if x > y else 2 * y) + (1 if x < 0 else (2 if y < 0 else 3.5))
### comparisons
def f(x, y):
    less = (1 if x < y else 2) + (4 if x <= 0 else 0)
    return less + (8 if x == 1 else 0) + (16 if y != 1 else 0) + (32 if x >= y else 0)
### a chain of comparisons
def f(x, y):
    return 1.5 if -1 < x <= y < 2.5 else y
### not, and, or
def f(x, y):
    a, b = x > 0, y > 0
    return 1 if not a and (b or x < y) or not (b and a) else 2
### truth values
def f(x, y):
    sure = True
    sure = sure and x > y
    return 1.0 if sure else False
### flags
def f(x, y):
    return (1 if x > 0 else 0) | (2 if y > 0 else 0) | (4 if x > y else 0) | 8
### an early return
def f(x, y):
    if x > 1:
        return y
    y = y + 1
    return x + y
### early returns
def f(x, y):
    if x > 1:
        return y
    if y > 1:
        return 2 * x
    if x > y:
        return 3 * y
    return x - y
### a loop in a loop
def f(x, y):
    for _ in range(2):
        x = x + 1
        for _ in range(3):
            x = x / 2 + y
    return x
### infinite constants
BOTTOM = -float("inf")
def f(x, y):
    return x if y > BOTTOM else -BOTTOM
### assignments in a branch
def f(x, y):
    a, b = x, y
    if x > y:
        a, b = 2 * x, 3 * y
    return a - b
### and in the other
def f(x, y):
    a = 0.5
    if x > y:
        a = x
    else:
        a = -y
    return a
### a loop
N = 3
def f(x, y):
    for _ in range(N):
        x = x / 2 + y
    return x
### a loop with its count
def f(x, y):
    for k in range(2 + 1):
        x = x * y + k
    return x
### calls
def g(x):
    return 2 * x
def f(x, y):
    return h(x, y) + g(g(y))
def h(x, y):
    return x - g(y)
### abs and sqrt
from math import sqrt
def f(x, y):
    return sqrt(abs(x)) - abs(y)
### infinity
from math import inf
def f(x, y):
    top = inf if x > 0 else -inf
    return y if y < top else 1.0
### global numbers
SMALL, FLAG = 1e-3, 4
def f(x, y):
    return SMALL * x + (FLAG if y > 0 else 0)
### a tuple passed on
def g(box, k):
    lo, hi, n = box
    return (lo + k * hi) * n
def f(x, y):
    box = (x, 2 * y, 3)
    return g(box, y) - g((y, x, 2), 1.0)
### a tuple handed through
def h(box):
    lo, hi = box
    return lo - hi
def g(box):
    lo, _ = box
    return h(box) + lo
def f(x, y):
    return g((x, y))
### a global tuple
FLAGS = (1, 2)
def g(x, flags):
    low, high = flags
    return low if x < 0 else high
def f(x, y):
    return g(x, FLAGS) | 4
### a tuple returned
def g(x, y):
    low = x if x < y else y
    high, sure = x + y - low, x != y
    return low, high, sure
def f(x, y):
    low, high, sure = g(x, y)
    return high - 2 * low if sure else 0.25
### nested unpacking
def g(x):
    a, b = x + 1, x - 1
    return a, b
def f(x, y):
    (a, b), (c, d) = g(x), g(y)
    return a * b + c / (d * d + 1)
### tuples chosen
def f(x, y):
    a, b = (x, 1.0) if x > y else (y, -1.0)
    return a * b
### a choice between calls
def g(x):
    a, b = x + 1, x - 1
    return a, b
def f(x, y, which=None):
    a, b = g(x) if which is None else g(y)
    return a * b
### an argument that may be None
def f(x, y, which=None):
    return x if which is None else x * which
### a statement on None
def f(x, y, which=None):
    z = y
    if which is None:
        z = x
    else:
        z = x - which
    return z
### numbers that become real
def g(x):
    return x, 2 * x
def f(x, y):
    n = 1
    n = n + y
    if x > 1:
        return 1
    a, b = g(1)
    return a * b + n
### powers
def f(x, y):
    return x**2 - (x + y) ** 3
### two targets
def f(x, y):
    a = b = x + y
    return a * b
### unused names and comments
def f(x, y):
    '''Return θ² ≤ `y`.'''
    # to be found again
    return x + y  # at the end
""")

NUMPY_REFUSES = cases("""
### a while loop
def f(x):
    while x > 1:
        x = x / 2
    return x
### an assignment with a sum
def f(x):
    x += 1
    return x
### a name first assigned in a branch
def f(x):
    if x > 0:
        y = x
    return y
""")

BOTH_REFUSE = cases("""
### a remainder
def f(x):
    return x % 2
### an element
def f(x):
    return x[0]
### an attribute
def f(x):
    return x.real
### a named argument
def g(x):
    return x
def f(x):
    return g(x=x)
### a value that asks for a new name
def f(x, y):
    x, y = y, x
    return x - y
### a loop over something
def f(x):
    for y in x:
        x = y
    return x
### an identity
def f(x):
    return 1.0 if x is True else 2.0
### a nested function
def f(x):
    def g(y):
        return y
    return g(x)
""")

C_REFUSES = cases("""
### None
def f(x):
    return 1.0 if x is None else 2.0
### a function that C has not
from math import exp
def f(x):
    return exp(x)
### a text
NAME = 'x'
def f(x):
    return NAME
### a number that becomes a tuple
def g(x):
    a, b = x, x
    return a, b
def f(x):
    y = 1.0
    y = g(x)
    return x
### a tuple assigned again
def g(box):
    a, b = box
    return a + b
def f(x):
    box = (x, 1.0)
    box = (1.0, x)
    return g(box)
### a loop's variable assigned
def f(x):
    for k in range(3):
        k = x
    return x
### a loop's variable behind its loop
def f(x):
    for k in range(3):
        x = x + k
    return x * k
### an argument named like a keyword of C
def f(short):
    return 2.0 * short
### a variable named like a keyword of C
def f(x):
    register = 2.0 * x
    return register
### a loop's variable named like a keyword of C
def f(x):
    for unsigned in range(3):
        x = x + unsigned
    return x
### a function named like a keyword of C
def double(x):
    return 2.0 * x
def f(x):
    return double(x)
### a number that is no truth value
def f(x):
    return 1.0 if x and x > 1 else 2.0
### flags of a number
def f(x):
    return x | 1
### a tuple that nobody unpacks
def g(x):
    return 1.0
def f(x):
    return g((x, x))
### arguments that are missing
def g(x, y=None):
    return x
def f(x):
    return g(x)
""")
