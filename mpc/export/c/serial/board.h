/* A board on the serial line: it reads sensors, sets valves, and lets the pressures fall when the host is silent. */
#ifndef ANT_BOARD_H
#define ANT_BOARD_H

#include "config.h"
#include "frames.h"
#include "port.h"

#ifdef ANT_BOARD_CONTROLS
#include "follow.h"
#endif

typedef struct {
    ant_receiver receiver;
    ant_state state;
    uint16_t session, sequence; /* of the last request */
    uint32_t heard;             /* when the last command came [us] */
    uint32_t commands;          /* number received */
    uint32_t moved;             /* when the valves were last set [us] */
    float u[ANT_MUSCLES];       /* to these pressures [Pa] */
#ifdef ANT_BOARD_CONTROLS
    ant_follower follower;
#endif
} ant_board;

/* Begin, with all muscles at the least pressure. */
void ant_board_begin(ant_board *board);

/* Call as often as possible: it answers received bytes and advances time. */
void ant_board_poll(ant_board *board);

#endif /* ANT_BOARD_H */
