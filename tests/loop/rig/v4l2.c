/* A webcam for programs that load this library by LD_PRELOAD. It answers the ioctls of V4L2 as the driver uvcvideo does.

   The device file is a regular file of three slots of SLOT bytes, one slot a mode, with the picture that the mode gives. So only ioctl is
   replaced: open, mmap, select and close are the system's. */

#include <errno.h>
#include <linux/videodev2.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <unistd.h>

#define SLOT (1280 * 720 * 2)
#define BUFFERS 10
#define COUNT(table) (sizeof(table) / sizeof((table)[0]))

static const struct {
    __u32 format, width, height;
    struct v4l2_fract period_s;
} modes[] = {
    {V4L2_PIX_FMT_YUYV, 640, 480, {1001, 30000}},
    {V4L2_PIX_FMT_YUYV, 1280, 720, {1, 10}},
    {V4L2_PIX_FMT_MJPEG, 1280, 720, {1, 30}},
};
static unsigned mode, buffers, queue[BUFFERS], queued, streaming;

static int refuse(int reason)
{
    errno = reason;
    return -1;
}

/* The mode with the nearest area among those of the format, or of the first format if the camera does not have that one. */
static unsigned nearest(const struct v4l2_pix_format *wanted)
{
    __u32 format = modes[0].format;
    long least = -1;
    unsigned found = 0;
    for (unsigned k = 0; k < COUNT(modes); k++)
        if (modes[k].format == wanted->pixelformat)
            format = wanted->pixelformat;
    for (unsigned k = 0; k < COUNT(modes); k++) {
        long off = labs((long)modes[k].width * modes[k].height - (long)wanted->width * wanted->height);
        if (modes[k].format == format && (least < 0 || off < least))
            least = off, found = k;
    }
    return found;
}

static __u32 size(void)
{
    return 2 * modes[mode].width * modes[mode].height;
}

static int describe(struct v4l2_buffer *buffer)
{
    if (buffer->index >= buffers)
        return refuse(EINVAL);
    buffer->m.offset = mode * SLOT;
    buffer->length = buffer->bytesused = size();
    return 0;
}

int ioctl(int file, unsigned long request, ...)
{
    va_list rest;
    va_start(rest, request);
    void *argument = va_arg(rest, void *);
    va_end(rest);
    struct v4l2_capability *capability = argument;
    struct v4l2_format *format = argument;
    struct v4l2_fract *period_s = &((struct v4l2_streamparm *)argument)->parm.capture.timeperframe;
    struct v4l2_requestbuffers *wanted = argument;
    struct v4l2_buffer *buffer = argument;

    if (_IOC_TYPE(request) != 'V')
        return syscall(SYS_ioctl, file, request, argument);
    switch ((__u32)request) {
    case VIDIOC_QUERYCAP:
        *capability = (struct v4l2_capability){.driver = "uvcvideo", .card = "webcam"};
        capability->device_caps = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
        capability->capabilities = capability->device_caps | V4L2_CAP_DEVICE_CAPS;
        return 0;
    case VIDIOC_S_FMT:
        if (buffers)
            return refuse(EBUSY);
        mode = nearest(&format->fmt.pix);
        /* fall through */
    case VIDIOC_G_FMT:
        format->fmt.pix = (struct v4l2_pix_format){
            .width = modes[mode].width,
            .height = modes[mode].height,
            .pixelformat = modes[mode].format,
            .field = V4L2_FIELD_NONE,
            .bytesperline = modes[mode].format == V4L2_PIX_FMT_YUYV ? 2 * modes[mode].width : 0,
            .sizeimage = size(),
        };
        return 0;
    case VIDIOC_S_PARM: /* there is one rate a mode */
    case VIDIOC_G_PARM:
        *period_s = modes[mode].period_s;
        return 0;
    case VIDIOC_REQBUFS:
        if (streaming)
            return refuse(EBUSY);
        buffers = wanted->count = wanted->count < BUFFERS ? wanted->count : BUFFERS;
        return 0;
    case VIDIOC_QUERYBUF:
        return describe(buffer);
    case VIDIOC_QBUF:
        if (queued == buffers || buffer->index >= buffers)
            return refuse(EINVAL);
        queue[queued++] = buffer->index;
        return 0;
    case VIDIOC_DQBUF:
        if (!streaming || !queued)
            return refuse(EINVAL);
        usleep(1000000L * modes[mode].period_s.numerator / modes[mode].period_s.denominator);
        buffer->index = queue[0];
        memmove(queue, queue + 1, --queued * sizeof(queue[0]));
        return describe(buffer);
    case VIDIOC_STREAMON:
    case VIDIOC_STREAMOFF:
        streaming = (__u32)request == VIDIOC_STREAMON;
        queued = streaming ? queued : 0;
        return 0;
    case VIDIOC_QUERYCTRL: /* it has no controls */
        return refuse(EINVAL);
    default: /* enumerations too, for which OpenCV does not ask */
        return refuse(ENOTTY);
    }
}
