/* Count the turns that a tethered vehicle puts into its tether: tether_counter.py at order 2, in C99, without error.

   cc -std=c99 -O2 -ffp-contract=off -o tether_counter tether_counter.c -lm

   Lines on standard input: time (s) and the attitude, body to earth, as a quaternion w x y z of length 1. The frame that
   does not twist is carried from axis to axis by reflection in the plane that bisects them; the twist is the angle from
   it to the body, with the whole turns nearest to the angle before. A step is flagged in which the body turned by half a
   turn, or would have turned by more in that time at its last speed. `struct counter` is all that is kept. */

#include <math.h>
#include <stdio.h>

#define PI 3.14159265358979323846

struct counter {
    int begun, flagged;
    double q[4], axis[3], carried[3]; /* the attitude, the axis, and the vector that is carried with it */
    double time, speed, base, twist;  /* s, rad/s, rad, rad */
};

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void turn(const double *q, const double *a, double *to) {
    double x = q[1], y = q[2], z = q[3], w = q[0];
    double px = 2 * (y * a[2] - z * a[1]), py = 2 * (z * a[0] - x * a[2]), pz = 2 * (x * a[1] - y * a[0]);
    to[0] = a[0] + w * px + (y * pz - z * py);
    to[1] = a[1] + w * py + (z * px - x * pz);
    to[2] = a[2] + w * pz + (x * py - y * px);
}

static double angle(const double *to, const double *axis, const double *from) {
    double side[3] = {axis[1] * from[2] - axis[2] * from[1], axis[2] * from[0] - axis[0] * from[2],
                      axis[0] * from[1] - axis[1] * from[0]};
    return atan2(dot(to, side), dot(to, from));
}

/* Carry v from axis a to axis b; 0 where they are opposite. */
static int carry(double *v, const double *a, const double *b) {
    double c[3] = {a[0] + b[0], a[1] + b[1], a[2] + b[2]}, square = dot(c, c), f;
    if (square < 1e-14) return 0;
    f = 2 * dot(v, c) / square;
    for (int i = 0; i < 3; i++) v[i] -= f * c[i];
    f = dot(b, v);
    for (int i = 0; i < 3; i++) v[i] -= f * b[i];
    f = 1.5 - 0.5 * dot(v, v);
    for (int i = 0; i < 3; i++) v[i] *= f;
    return 1;
}

double counter_update(struct counter *c, double time, const double given[4]) {
    static const double along[3] = {1, 0, 0}, beside[3] = {0, 1, 0};
    double q[4], axis[3], body[3], size = 0, same = 0;
    for (int i = 0; i < 4; i++) size += given[i] * given[i];
    for (int i = 0; i < 4; i++) q[i] = given[i] / sqrt(size);
    turn(q, along, axis);
    turn(q, beside, body);
    size = sqrt(dot(axis, axis));
    for (int i = 0; i < 3; i++) axis[i] /= size;
    if (c->begun) {
        for (int i = 0; i < 4; i++) same += q[i] * c->q[i];
        double step = 2 * atan2(sqrt(fmax(1 - same * same, 0)), fabs(same)), span = time - c->time;
        if (fmax(step, c->speed * span) >= PI * (1 - 1e-9))
            c->flagged++;
        else
            c->speed = step / span;
    }
    if (!c->begun || !carry(c->carried, c->axis, axis)) {
        for (int i = 0; i < 3; i++) c->carried[i] = body[i];
        carry(c->carried, axis, axis);
        c->base = angle(body, axis, c->carried) - c->twist;
    } else {
        double now = angle(body, axis, c->carried) - c->base;
        c->twist = now + 2 * PI * floor((c->twist - now) / (2 * PI) + 0.5);
    }
    for (int i = 0; i < 3; i++) c->axis[i] = axis[i];
    for (int i = 0; i < 4; i++) c->q[i] = q[i];
    c->time = time, c->begun = 1;
    return c->twist;
}

int main(void) {
    struct counter c = {0};
    double time, q[4];
    while (scanf("%lf %lf %lf %lf %lf", &time, &q[0], &q[1], &q[2], &q[3]) == 5) {
        printf("%.6g s: %+.12f turns", time, counter_update(&c, time, q) / (2 * PI));
        if (c.flagged) printf(" (%d gaps too long)", c.flagged);
        putchar('\n');
    }
    return 0;
}
