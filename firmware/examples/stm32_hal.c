/* Copyright 2026 The mecarover_serial authors */
/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The receiver on an STM32 with HAL: DMA up to the idle line, CRC unit, independent watchdog.
 *
 * compiled: gcc 12.2 for Cortex-M4, ST's HAL driver of 2024-08 (F405), no warnings
 * tried: on the host, with a simulated HAL. Not tried on silicon: DMA, idle line, CRC unit, IWDG.
 *
 * Call vel2d_start() once, vel2d_control() every 30 ms. Interrupts of the UART and its DMA stream
 * must be on. With a data cache (F7, H7) put `bytes` into memory that is not cached.
 */
#include "main.h"                       /* your CubeMX project has it, with the HAL */
#include "vel2d_receiver.h"

extern UART_HandleTypeDef huart6;       /* with DMA for RX, mode normal */
extern CRC_HandleTypeDef hcrc;          /* poly 0x4C11DB7, start 0xFFFFFFFF, nothing inverted */
extern IWDG_HandleTypeDef hiwdg;        /* about 100 ms: resets an MCU that hangs */
void set_velocity(double x, double y, double omega);    /* yours: m/s, m/s, rad/s */

static vel2d_receiver receiver;
static uint8_t bytes[2 * VEL2D_FRAME];

/* The unit of an F4 takes words only: set crc_input of the bridge to words. */
static uint32_t crc_of_unit(const uint8_t *values)
{
    return HAL_CRC_Calculate(&hcrc, (uint32_t *)(uintptr_t)values, VEL2D_VALUES / 4);
}

static void listen(void)
{
    if (HAL_UARTEx_ReceiveToIdle_DMA(&huart6, bytes, sizeof bytes) == HAL_OK)
        __HAL_DMA_DISABLE_IT(huart6.hdmarx, DMA_IT_HT);     /* no call at half of the buffer */
}

void vel2d_start(void)
{
    vel2d_settings settings = VEL2D_DEFAULTS;
    settings.crc = crc_of_unit;
    settings.most.x = settings.most.y = 0.55;
    settings.most.omega = 1.76;
    vel2d_begin(&receiver, &settings);
    listen();
}

void HAL_UARTEx_RxEventCallback(UART_HandleTypeDef *uart, uint16_t size)
{
    if (uart != &huart6)
        return;
    vel2d_feed(&receiver, bytes, size, HAL_GetTick());
    if (size < sizeof bytes)
        vel2d_idle(&receiver);
    listen();
}

void HAL_UART_ErrorCallback(UART_HandleTypeDef *uart)       /* an overrun, for example, ends it */
{
    if (uart != &huart6)
        return;
    vel2d_idle(&receiver);
    listen();
}

void vel2d_control(void)
{
    static char text[VEL2D_REPORT];     /* the UART reads it after this function has returned */
    size_t length = 0;
    vel2d_velocity velocity;
    __disable_irq();
    velocity = vel2d_now(&receiver, HAL_GetTick());
    if (huart6.gState == HAL_UART_STATE_READY)
        length = vel2d_report(&receiver, HAL_GetTick(), text);
    if (huart6.RxState == HAL_UART_STATE_READY)
        listen();                       /* it could not begin in the callback: HAL was busy */
    __enable_irq();
    set_velocity(velocity.x, velocity.y, velocity.omega);
    if (length)
        HAL_UART_Transmit_IT(&huart6, (uint8_t *)text, (uint16_t)length);
    HAL_IWDG_Refresh(&hiwdg);
}
