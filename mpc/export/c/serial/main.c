/* The board's main loop; feed a hardware watchdog in it. */
#include "board.h"

int main(void) {
    static ant_board board;
    ant_board_begin(&board);
    for (;;) ant_board_poll(&board);
}
