/* The controller on the board follows references that the host sends ahead of time, by the board's own clock. */
#ifndef ANT_FOLLOW_H
#define ANT_FOLLOW_H

#include <stdint.h>

#include "antagonist.h"
#include "config.h"

/* Samples are numbered from 0, when the host began; those that are not over are held, the rest is forgotten. */
typedef struct {
    ant_controller controller;
    ant_plan plan;
    ant_reference window;
    float theta[ANT_ROOM][ANT_JOINTS], K[ANT_ROOM][ANT_STIFFNESSES]; /* sample k at k modulo ANT_ROOM */
    uint32_t have;   /* samples received, which is the number of the next one */
    uint32_t sample; /* that is followed now */
    uint32_t due;    /* when the next one is [us] */
    int running;     /* whether there were enough samples to begin */
} ant_follower;

void ant_follower_begin(ant_follower *f);

/* Take n samples from number `first` on, skipping those already received. Returns 0, or the reason for a refusal. */
int ant_follower_take(ant_follower *f, uint32_t first, const uint8_t *samples, uint32_t n);

/* Take a step of the controller if one is due; returns whether it did and f->plan is new. */
int ant_follower_step(ant_follower *f);

#endif /* ANT_FOLLOW_H */
