/* src/recursions.c with numbers that count their multiplications and divisions. */
#include <math.h>
#include <string.h>

extern "C" long ant_counted;
long ant_counted = 0;

struct counted {
    double value;
    counted() = default;
    counted(double from) : value(from) {}
    counted operator-() const { return -value; }
    counted &operator+=(counted b) { return value += b.value, *this; }
    counted &operator-=(counted b) { return value -= b.value, *this; }
    counted &operator*=(counted b) { return ant_counted++, value *= b.value, *this; }
    counted &operator/=(counted b) { return ant_counted++, value /= b.value, *this; }
    friend counted operator+(counted a, counted b) { return a += b; }
    friend counted operator-(counted a, counted b) { return a -= b; }
    friend counted operator*(counted a, counted b) { return a *= b; }
    friend counted operator/(counted a, counted b) { return a /= b; }
    friend bool operator<(counted a, counted b) { return a.value < b.value; }
    friend bool operator>(counted a, counted b) { return a.value > b.value; }
    friend bool operator<=(counted a, counted b) { return a.value <= b.value; }
    friend bool operator>=(counted a, counted b) { return a.value >= b.value; }
};

#define double counted /* ant_real is one of them, with the layout of a double */
extern "C" {
#include "src/recursions.c"
}
